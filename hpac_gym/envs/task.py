"""What an environment needs from a task: to draw episodes, to judge them, and to shape the reward.

A task is a plain object. It holds the state of one episode between `start` and the outcome, and knows no action, no
observation vector and no simulator beyond the `Scene` that it is shown.
"""

from __future__ import annotations

from enum import Enum
from typing import Protocol

import numpy as np

from hpac_gym.envs.grip import Grip
from hpac_gym.envs.observation import Field
from hpac_gym.model import Hand
from hpac_gym.model.checks import Array
from hpac_gym.sim import Camera, Scene, SceneSetup, Vector


class Outcome(Enum):
    """How an episode stands."""

    RUNNING = "running"
    SUCCESS = "success"
    FAILURE = "failure"


class Schedule(Protocol):
    """The phases of an episode and the wrist's path through them."""

    @property
    def phases(self) -> tuple[str, ...]:
        """Names, in order."""
        ...

    @property
    def duration(self) -> float:
        """Length of an episode [s]."""
        ...

    def phase(self, time: float) -> int:
        """Index into `phases` of the one that runs, or begins, at a time [s]; the last one stays."""
        ...

    def wrist_path(self, time: float) -> Vector:
        """Offset of the wrist in the world at a time [s], [m]."""
        ...


class Task(Protocol):
    """One task of `HandEnv`."""

    @property
    def timetable(self) -> Schedule: ...

    @property
    def fields(self) -> tuple[Field, ...]:
        """What the task adds to the end of the observation."""
        ...

    @property
    def viewpoint(self) -> Camera:
        """Where pictures are taken from; they follow the wrist."""
        ...

    grip: Grip
    """How the hand holds the object."""

    def setup(self, rng: np.random.Generator, hand: Hand) -> SceneSetup:
        """Draw one episode; everything random comes from `rng`."""
        ...

    def start(self, setup: SceneSetup) -> None:
        """Begin to judge an episode."""
        ...

    def values(self, scene: Scene) -> Array:
        """The values of `fields` now."""
        ...

    def judge(self, scene: Scene, object_pos: Array, forces: dict[str, float], dt: float) -> Outcome:
        """Advance by one control step and judge the episode.

        Args:
            scene: the physics after the step.
            object_pos: true centre of the object in the hand frame, shape (3,) [m].
            forces: between the object and each part of the hand that touches it [N].
            dt: control period [s].
        """
        ...

    def reward_terms(
        self, outcome: Outcome, phase: int, object_pos: Array, forces: dict[str, float], action_change: Array
    ) -> dict[str, float]:
        """The dense reward of the step that `judge` has judged, term by term; the reward is their sum.

        Args:
            outcome: what `judge` said.
            phase: index of the phase that the step began in.
            object_pos: as for `judge`.
            forces: as for `judge`.
            action_change: difference to the action before, shape (6,).
        """
        ...
