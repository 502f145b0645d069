"""What `hpac record --format lerobot` writes, lerobot reads. Not a test of ``make test``, whose
Python is too old for lerobot: ``make test-lerobot``."""

import errno
from unittest.mock import Mock

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from hpac import main
from hpac_gym.evaluation.dataset import record

WORDS = ["record", "--format", "lerobot", "--engine", "mujoco", "-n", "2", "--seed-start", "3"]


def test_the_episodes_come_back_as_they_were(tmp_path, capsys):
    recorded = record(
        "scripted",
        "HPAC-Grasp-v0",
        2,
        tmp_path / "minari",
        seed_start=3,
        options={"engine": "mujoco"},
    )
    assert main([*WORDS, "--out", str(tmp_path / "lerobot")]) == 0
    assert f"2 episodes, {recorded.total_steps} steps" in capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lerobot", "minari"]
    read = LeRobotDataset("any/name", root=tmp_path / "lerobot")
    assert (read.fps, read.num_episodes, read.num_frames) == (20, 2, recorded.total_steps)
    assert str(read.meta._version).startswith("3")
    assert read.features["action"]["names"][0] == "thumb_mp"
    assert len(read.features["observation.state"]["names"]) == 44
    frames = iter(read[index] for index in range(read.num_frames))
    for number, episode in enumerate(recorded.iterate_episodes()):
        for step, action in enumerate(episode.actions):
            frame = next(frames)
            assert np.array_equal(frame["action"], action)
            assert not np.array_equal(frame["action"], action + 0.1)
            assert np.array_equal(frame["observation.state"], episode.observations[step])
            assert float(frame["next.reward"]) == pytest.approx(episode.rewards[step])
            assert bool(frame["next.done"]) == (step == len(episode.actions) - 1)
            assert bool(frame["next.success"]) == episode.infos["is_success"][step + 1]
            assert (int(frame["seed"]), int(frame["episode_index"])) == (3 + number, number)
            assert frame["task"] == "HPAC-Grasp-v0"


@pytest.mark.parametrize(
    ("fault", "status", "told"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (OSError(errno.ENOSPC, "No space left on device"), 2, "No space left on device"),
    ],
)
def test_a_folder_appears_whole_or_not_at_all(fault, status, told, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(LeRobotDataset, "save_episode", Mock(side_effect=fault))
    assert main([*WORDS, "--out", str(tmp_path / "lerobot")]) == status
    assert capsys.readouterr().err.splitlines()[-1].endswith(told)
    assert list(tmp_path.iterdir()) == []
