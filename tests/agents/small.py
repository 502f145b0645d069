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
SMALL = [
    word for name, value in SETTINGS.items() for word in (f"--{name.replace('_', '-')}", value)
]
"""The settings as words of the command."""


def train_here(*words, make=None) -> None:
    """Train in this process, which has loaded the packages already; its signals stay its own."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(train, "_stop_on_signal", lambda progress: None)
        assert train.main([str(word) for word in words], make) == 0
