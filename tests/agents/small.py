"""Trainings of seconds."""

import numpy as np
import pytest

from agents import train
from agents.learner import Learner
from agents.recipes import Recipe

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


def fitted(recipe: Recipe, observed: int) -> Learner:
    """A learner of closures of the grasp task, fitted to thirty trials of no meaning."""
    rng = np.random.default_rng(0)
    learner = Learner(recipe, observed, deployed=44, phases=4)
    seen = rng.standard_normal((30, observed))
    end_state = rng.standard_normal((30, observed - 44))
    learner.trials.add(seen, rng.uniform(-1, 1, (30, 8)), rng.integers(0, 5, 30), end_state)
    learner.learn(0.5)
    return learner


def train_here(*words, drawn: bool = False) -> None:
    """Train in this process, which has loaded the packages already; its signals stay its own. Its
    picture, which takes half of the time, is an empty file unless it is `drawn`.
    """
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(train, "_stop_on_signal", lambda progress: {})
        if not drawn:
            monkeypatch.setattr(train, "draw", lambda path, *_: path.touch())
        assert train.main([str(word) for word in words]) == 0
