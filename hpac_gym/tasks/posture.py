"""The posture task: bring fifteen joints to a posture with six servos, for hindsight replay."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINTS, SERVO_INDEX, SERVOS, Hand, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState, Viewpoint
from hpac_gym.tasks.cameras import CameraNoise, MarkerCamera
from hpac_gym.tasks.config import check_bounds
from hpac_gym.tasks.task import RUNNING, Task, setting
from hpac_gym.tasks.terms import COMMAND_TERMS, HAND_TERMS, Moment, RewardTerm, Term

TOLERANCE = 0.05
"""Default of `PostureConfig.tolerance` [rad]."""
CAMERA_NOISE = np.deg2rad(0.1)
"""Standard deviation of a joint angle that a camera measures from markers, as in the paper's experiment [rad]."""
FREE_THUMB_FINGERS = 0.35
"""Where the thumb may be anywhere, the fingers stay this far open, out of its way [rad]."""
FREE_FINGERS_THUMB = (0.5, 0.3)
"""Where the fingers may be anywhere, the thumb's MP and CMC stay below these, out of their way [rad]."""


BLOCKED_MP, BLOCKED_CMC = 0.75, (0.05, 1.0)
"""Beside such fingers, a thumb with more MP, and with its CMC in this range, meets the index finger on its way [rad]."""


@dataclass(frozen=True, slots=True)
class PostureConfig:
    """What the episodes are like."""

    duration: float = setting(2.0, "length of an episode, which the time limit cuts [s]", bounds=(0.05, 1e3))
    tolerance: float = setting(TOLERANCE, "a posture is reached when no joint is farther from it [rad]", bounds=(1e-3, 1.0))

    def __post_init__(self) -> None:
        check_bounds(self, "config")


def goal_error(achieved: Array, desired: Array) -> Array:
    """Distance of every joint from its goal, shapes (..., 15) [rad]."""
    return np.abs(np.asarray(achieved, dtype=float) - desired)


class Posture(Task):
    """Draws goals and measures how far the joints are from them: a `hpac_gym.tasks.task.Task`.

    The hand alone, palm to the side; no object, no wrist. An episode has no end but the time limit.

    Args:
        config: what counts as reached.
        reachable: leave out the goals in which another digit stands in the thumb's way.
    """

    phases = ("move",)
    viewpoint = Viewpoint()
    terms = COMMAND_TERMS
    privileged_terms = HAND_TERMS
    goal_terms = (
        Term("joint_pos", JOINTS, "rad", -0.5, 2.0, "joint angle: achieved as a camera measures it, or desired",
             lambda now: now.seen["joint_pos"]),
    )  # fmt: skip
    grip = None

    def __init__(self, config: PostureConfig = PostureConfig(), reachable: bool = False) -> None:
        self.config, self.duration, self.reachable = config, config.duration, reachable
        self.reward_terms = (
            RewardTerm("error", "−1 · mean distance of the joints from the goal [rad]", lambda now: -self._error.mean(axis=1)),
        )

    def prepare(self, num_worlds: int, noise: CameraNoise) -> MarkerCamera:
        """Get ready for n worlds; returns their camera.

        Raises:
            ParameterError: Noise of a camera that sees objects is given: there is none here.
        """
        if noise != CameraNoise():
            raise ParameterError(f"noise {noise}: a posture has no object; its camera has a noise of {CAMERA_NOISE:.3g} rad")
        self.goal = np.zeros((num_worlds, len(JOINTS)))
        self._error = np.zeros((num_worlds, len(JOINTS)))
        return MarkerCamera(num_worlds, CAMERA_NOISE)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the open hand, and a goal.

        Half of the goals move the thumb freely and half the fingers, since one can stand in the other's way. With `reachable`
        a goal that the index finger blocks is drawn anew.
        """
        highest = hand.synergy_max.copy()
        mp, cmc = SERVO_INDEX["thumb_mp"], SERVO_INDEX["thumb_cmc"]
        if rng.random() < 0.5:
            highest[[index for index in range(len(SERVOS)) if index not in (mp, cmc)]] = FREE_THUMB_FINGERS
        else:
            highest[[mp, cmc]] = FREE_FINGERS_THUMB
        synergy = rng.uniform(hand.synergy_min, highest)
        while self.reachable and synergy[mp] > BLOCKED_MP and BLOCKED_CMC[0] < synergy[cmc] < BLOCKED_CMC[1]:
            synergy = rng.uniform(hand.synergy_min, highest)
        return SceneSetup(None, hand=hand, goal=joints_from_synergy(synergy, hand))

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Begin episodes in some worlds."""
        self.goal[np.asarray(worlds)] = [setup.goal for setup in setups]

    def wrist_path(self, setup: SceneSetup, times: tuple[float, ...]) -> Array:
        """The wrist stays where it is: zeros, shape (len(times), 3) [m]."""
        return np.zeros((len(times), 3))

    def phase(self, time: Array) -> NDArray[np.int_]:
        """There is only one."""
        return np.zeros(len(time), dtype=int)

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """No posture ends an episode: one that is reached is to be kept."""
        return np.full(len(state.time), RUNNING)

    def measure(self, achieved: Array, desired: Array) -> None:
        """Take in what the camera measures and the goal as observed, shapes (n, 15) [rad]."""
        self._error = goal_error(achieved, desired)

    def sparse_reward(self, now: Moment) -> Array:
        """0 where the posture is reached, −1 elsewhere, shape (n,)."""
        return -(self._error.max(axis=1) > self.config.tolerance).astype(float)

    def goal_reward(self, achieved: Array, desired: Array, dense: bool) -> Array:
        """The dense or the sparse reward of postures against goals, shapes (..., 15) [rad], for hindsight replay."""
        error = goal_error(achieved, desired)
        return -error.mean(axis=-1) if dense else -(error.max(axis=-1) > self.config.tolerance).astype(float)

    def report(self, now: Moment) -> dict[str, Any]:
        """What `info` says of a step."""
        largest = self._error.max(axis=1)
        return {"is_success": largest <= self.config.tolerance, "largest_error": largest}
