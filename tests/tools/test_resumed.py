"""The measurement of resumed trainings kills them indeed."""

import pytest

from agents import RunError
from agents.curves import read_curve
from agents.runs import saved_trials
from tools import resumed


@pytest.mark.slow
def test_a_training_is_killed_and_ends_with_all_its_trials(tmp_path, monkeypatch):
    small = {
        "num-envs": 4,
        "hidden": 16,
        "batch-size": 16,
        "actor-batch-size": 16,
        "random-episodes": 8,
        "checkpoint-every": 10,
    }
    monkeypatch.setattr(resumed, "SETTINGS", small)
    monkeypatch.setattr(resumed, "LATER_S", 0.5)
    resumed.train(tmp_path / "killed", seed=0, trials=200, kills=1)
    assert saved_trials(tmp_path / "killed") == 200
    assert (read_curve(tmp_path / "killed" / "progress.csv")["episodes"] == 200).sum() == 1
    monkeypatch.setattr(resumed, "LATER_S", 20.0)
    with pytest.raises(RunError, match="ended with status 0 after 20 trials"):
        resumed.train(tmp_path / "whole", seed=0, trials=20, kills=1)
