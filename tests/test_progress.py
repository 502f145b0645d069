"""The progress bar: passes every item on, and shows itself on standard error when its time has
come.
"""

import sys

import pytest

from hpac_gym import progress as module
from hpac_gym.progress import progress, waiting
from tests.processes import wait_for


def test_what_is_soon_done_shows_nothing(capsys):
    assert list(progress(range(5), "label")) == list(range(5))
    assert capsys.readouterr().err == ""


def test_what_takes_long_shows_how_far_it_is_on_a_terminal_alone(capsys, monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 0.0)
    assert list(progress("abcd", "label")) == list("abcd")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(progress("abcd", "label")) == list("abcd")
    seen = capsys.readouterr()
    assert seen.out == ""
    assert "label" in seen.err
    assert "4/4" in seen.err


@pytest.mark.parametrize("items", [[], [1]])
def test_none_is_shown_where_none_is_wanted(items, capsys, monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(progress(items, "label", shown=False)) == items
    assert capsys.readouterr().err == ""


def test_one_long_call_shows_how_long_it_has_taken(capsys, monkeypatch):
    monkeypatch.setattr(module, "_PATIENCE", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    with waiting("label"):
        wait_for(lambda: "label: 00:00" in capsys.readouterr().err)
