"""`make size`: what is counted, and what a capability costs."""

import ast

import pytest

from tools.size import PRICES, ROOT, files_of, main, price, statements


def test_statements_count_docstrings_and_nested_ones_and_no_width():
    long = "def f():\n    '''Text.'''\n    if x:\n        return (\n            1\n        )\n"
    assert statements(ast.parse(long)) == 4
    assert statements(ast.parse("a = 1; b = 2")) == 2


@pytest.mark.parametrize("parts", PRICES.values(), ids=PRICES)
def test_a_price_is_that_of_files_that_are_there(parts):
    assert all((ROOT / "hpac_gym" / part).exists() for part in parts)
    assert price(parts) == sum(price([part]) for part in parts) > 50


def test_no_file_is_paid_for_twice_and_all_prices_are_printed(capsys):
    parts = [f"hpac_gym/{part}" for parts in PRICES.values() for part in parts]
    files = files_of(parts)
    assert len(set(files)) == len(files)
    main()
    printed = capsys.readouterr().out
    assert all(f"| {name} | {price(parts)} |" in printed for name, parts in PRICES.items())
