"""Trainings of seconds."""

import pytest

from agents import train

SETTINGS = {
    "num_envs": "4",
    "hidden": "16",
    "batch_size": "16",
    "random_episodes": "8",
    "checkpoint_every": "8",
}


def words_of(settings: dict[str, str]) -> list[str]:
    """Settings as words of the command."""
    return [
        word for name, value in settings.items() for word in (f"--{name.replace('_', '-')}", value)
    ]


SMALL = words_of(SETTINGS)


def train_here(*words) -> None:
    """Train in this process, which has loaded the packages already; its signals stay its own."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(train, "_stop_on_signal", lambda progress: {})
        assert train.main([str(word) for word in words]) == 0
