"""Episodes from beginning to end."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.errors import EpisodeError
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.tasks.scripted import Script
from hpac_gym.tasks.task import CONTROL_HZ
from hpac_gym.tasks.terms import Layout

EASY = SceneSetup(
    ObjectSpec("cylinder", (0.027, 0.027, 0.05), mass=0.15, friction=0.8),
    np.array([0.048, 0.004, 0.112]),
    0.0,
    np.array([0, 0, 0, 0, 0, 1.2]),
)
"""A cylinder in a good place."""


OPEN = np.array([-1, -1, -1, -1, -1, 0.5], np.float32)
"""Action of the open hand, its thumb opposed."""


class Still(Script):
    """Keeps an action, that of the open hand by default."""

    def __init__(self, action: np.ndarray = OPEN) -> None:
        self.action = action

    def act(self, observation):
        return self.action


class Opens(Script):
    """Acts as another script does until a time [s], and then opens the hand."""

    def __init__(self, script: Script, at: float) -> None:
        self.script = script
        self.at = at

    def act(self, observation):
        self._time += 1 / CONTROL_HZ
        return (self.script if self._time <= self.at else Still()).act(observation)


def a_setup(**change) -> SceneSetup:
    """An easy cylinder, with some of its properties changed."""
    return replace(EASY, object=replace(EASY.object, **change))


def steps(env, policy, setup=None, seed=0) -> Iterator[tuple]:
    """What the reset and every step of an episode return; of the reset (observation, 0.0, False,
    False, info).
    """
    observation, info = env.reset(seed=seed, options={"setup": setup} if setup else None)
    policy.reset()
    returned = observation, 0.0, False, False, info
    yield returned
    while not (returned[2] or returned[3]):
        returned = env.step(policy.act(returned[0]))
        yield returned


def run(env, policy, setup=None, seed=0) -> tuple[list[dict], float]:
    """One episode: the infos of its steps, and its return."""
    _, rewards, _, _, infos = zip(*steps(env, policy, setup, seed), strict=True)
    return list(infos[1:]), sum(rewards)


def check_stopped(env) -> None:
    """No episode is running: a step is refused."""
    with pytest.raises(EpisodeError, match="reset"):
        env.step(np.zeros(env.action_space.shape))


def part(observation: np.ndarray, terms, name: str) -> np.ndarray:
    """The entries of a term in a vector that a table describes."""
    return observation[..., Layout(terms, 1).slices[name]]
