"""The search for closures: its file is PyBullet's."""

import pytest

from hpac_gym.command import run
from tests.options import refused
from tools import blind_search


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--engine", "mujoco"], "--engine is 'mujoco': the closures of grasp_closures.csv are"),
        (["--engine", "nonsense", "--blind"], "invalid choice: 'nonsense'"),
    ],
)
def test_another_engine_is_not_given_the_results_of_this_one(words, message, monkeypatch, capsys):
    for name in ("search_all", "search_blind"):
        monkeypatch.setattr(blind_search, name, lambda *_: pytest.fail("it searches"))
    assert message in refused(capsys, lambda: run(lambda: blind_search.main(words)))
