"""`make size`: what is counted."""

import ast

from tools.size import statements


def test_statements_count_docstrings_and_nested_ones_and_no_width():
    long = "def f():\n    '''Text.'''\n    if x:\n        return (\n            1\n        )\n"
    assert statements(ast.parse(long)) == 4
    assert statements(ast.parse("a = 1; b = 2")) == 2
