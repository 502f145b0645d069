"""The progress bar: passes every item on, and shows itself on standard error when its time has
come.
"""

import re
import sys

from hpac_gym import progress as module
from hpac_gym.progress import progress, waiting
from tests.processes import wait_for


def test_what_takes_long_shows_how_far_it_is_on_a_terminal_alone(capsys, monkeypatch):
    assert list(progress(range(5), "soon done")) == list(range(5))
    monkeypatch.setattr(module, "_PATIENCE", 0.0)
    assert list(progress("abcd", "no terminal")) == list("abcd")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(progress([1], "not wanted", shown=False)) == [1]
    assert list(progress("abcd", "label")) == list("abcd")
    seen = capsys.readouterr()
    assert seen.out == ""
    assert re.fullmatch(r"\s*label: .*4/4 .*\s*", seen.err, re.S)


def test_one_long_call_shows_how_long_it_has_taken(capsys, monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with waiting("label"):
        wait_for(lambda: "label: 00:00" in capsys.readouterr().err)
