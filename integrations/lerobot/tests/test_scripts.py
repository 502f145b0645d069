"""LeRobot's scripts with the hand: what they record, and what is left of a hand whose script is killed."""

import json
import os

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot_robot_hpac.features import ACTIONS, PREDICTED

from tests import kills


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A recorded data set and an untrained policy."""
    folder = tmp_path_factory.mktemp("data")
    kills.untrained_policy(folder / "policy")
    kills.undisturbed("record", folder, folder)
    return folder


def test_what_was_recorded_has_names_and_the_actions_of_the_teleoperator(data):
    read = LeRobotDataset("test/hand", root=data / "episodes")
    assert (read.fps, read.num_episodes, read.meta.robot_type) == (20, 2, "hpac")
    assert read.features["action"]["names"] == list(ACTIONS)
    assert read.features["observation.state"]["names"] == [*ACTIONS, *PREDICTED]
    actions = np.array(read.hf_dataset["action"])
    states = np.array(read.hf_dataset["observation.state"])
    assert np.abs(actions).max() <= 1
    assert np.ptp(actions, axis=0)[:5].min() > 0.1  # the digits closed
    # What was commanded in a step is observed in the next one, but for the rate limit.
    assert np.median(np.abs(states[1:, :6] - actions[:-1])) < 1e-3


@pytest.mark.parametrize("script", ["replay", "rollout"])
def test_a_script_that_nobody_ends_ends_with_pulses_off(script, data, tmp_path):
    assert kills.undisturbed(script, data, tmp_path) > 3


def test_scripts_that_are_killed_leave_no_pulses(data):
    words = ["--times", "6", "--lanes", "6", "--script", "teleoperate", "--out", str(data)]
    assert kills.main(words) == 0
    rows = [json.loads(line) for line in (data / "teleoperate.jsonl").read_text().splitlines()]
    assert len(rows) == 6
    assert all(row["off"] for row in rows)
    assert any(row["powered"] and row["last"] > 0.5 for row in rows)


def test_the_judge_of_kills_sees_pulses_that_stay(data, tmp_path, monkeypatch):
    """The control: a script that is not killed, but only told something that it ignores."""
    monkeypatch.setattr(kills, "SIGNALS", (kills.signal.SIGCONT,))
    monkeypatch.setattr(kills, "PATIENCE", 1.0)
    row = kills.trial(0, "teleoperate", data, tmp_path, lasts=2.0)
    assert not row["off"]
    assert os.path.exists(tmp_path / "teleoperate-0" / "log.txt")
