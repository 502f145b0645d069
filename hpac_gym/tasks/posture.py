"""The posture task: bring fifteen joints to a posture with six servos, for hindsight replay."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVO_INDEX,
    SERVOS,
    Hand,
    action_from_synergy,
    joints_from_synergy,
)
from hpac_gym.model.checks import Array, as_array
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.settings import check_bounds, setting, settings_from
from hpac_gym.tasks.cameras import CameraNoise, MarkerCamera
from hpac_gym.tasks.privileged import HAND_TERMS
from hpac_gym.tasks.scripted import Script
from hpac_gym.tasks.task import (
    RUNNING,
    GoalSetup,
    Task,
    config_option,
)
from hpac_gym.tasks.terms import COMMAND_TERMS, Layout, Moment, RewardTerm, Term

TOLERANCE = 0.05
"""Default of `PostureConfig.tolerance` [rad]."""
CAMERA_NOISE = np.deg2rad(0.1)
"""Standard deviation of a joint angle that a camera measures from markers, as in the paper's
experiment [rad].
"""
FREE_THUMB_FINGERS = 0.35
"""Upper limit of the fingers' MCP in goals that move the thumb freely, which keeps the fingers out
of its way [rad].
"""
FREE_FINGERS_THUMB = (0.5, 0.3)
"""Upper limits of the thumb's MP and CMC in goals that move the fingers freely, which keep it out
of their way [rad].
"""
BLOCKED_MP = 0.75
BLOCKED_CMC = (0.05, 1.0)
"""In goals that move the thumb freely, the index finger blocks a thumb with more MP than this and
CMC in this range [rad].
"""

POSTURE_GAIN = 0.12
"""Fraction of a driven joint's error that each step of `ScriptedPosture` adds to the command."""
POSTURE_NEAR = 0.3
"""Largest distance from its goal at which a command is corrected; before, it moves to the goal
itself [rad].
"""
_DRIVEN = [JOINT_INDEX[name] for name in SERVOS]
_COMMANDED = [Layout(COMMAND_TERMS, 1).slices["joint_pos"].start + joint for joint in _DRIVEN]
"""Entries of an observation with the driven joints' angles that the model predicts for the command.
"""


@dataclass(frozen=True, slots=True)
class PostureConfig:
    """Duration of an episode, and tolerance of its goal."""

    duration: float = setting(
        2.0, "length of an episode, set by the time limit [s]", bounds=(0.05, 1e3)
    )
    tolerance: float = setting(
        TOLERANCE, "largest joint error of a reached posture [rad]", bounds=(1e-3, 1.0)
    )

    def __post_init__(self) -> None:
        check_bounds(self, "config")


class Posture(Task):
    """Draws goals and measures how far the joints are from them: a `hpac_gym.tasks.task.Task`.

    The hand is alone, palm to the side, without object and wrist motion. Only the time limit ends
    an episode.

    Args:
        config: duration and tolerance, or a mapping of some of them.

    Raises:
        ParameterError: Invalid config.
    """

    endless = True
    changing = ("_goals",)
    unused = ("noise",)
    terms = COMMAND_TERMS
    privileged_terms = HAND_TERMS
    goal_terms = (
        Term(
            "joint_pos",
            JOINTS,
            "rad",
            -0.5,
            2.0,
            "joint angle: achieved as a camera measures it, or desired",
            lambda now: now.seen["joint_pos"],
        ),
    )

    def __init__(
        self,
        config: Annotated[
            PostureConfig | Mapping[str, Any] | None,
            config_option(PostureConfig, "duration and tolerance"),
        ] = None,
    ) -> None:
        self.config = settings_from(PostureConfig(), config, "config")
        self.duration = self.config.duration
        self.reward_terms = (
            RewardTerm(
                "error",
                "−1 · mean distance of the joints from the goal [rad]",
                lambda now: self.goal_reward(*self._goals, True),
            ),
        )

    def prepare(self, num_worlds: int, noise: CameraNoise) -> MarkerCamera:
        """Allocate the state of n worlds; returns their camera.

        Raises:
            ParameterError: Noise of an object camera is given, but the task has no object.
        """
        if noise != CameraNoise():
            raise ParameterError(
                f"noise {noise}: a posture has no object; its camera has a noise of {CAMERA_NOISE:.3g} rad"
            )
        self.goal = np.zeros((num_worlds, len(JOINTS)))
        return MarkerCamera(num_worlds, CAMERA_NOISE)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: the open hand, and a goal.

        Half of the goals move the thumb freely and half the fingers, since they can block each
        other. Goals in which the index finger blocks the thumb are redrawn."""
        highest = hand.synergy_max.copy()
        mp = SERVO_INDEX["thumb_mp"]
        cmc = SERVO_INDEX["thumb_cmc"]
        if rng.random() < 0.5:
            highest[[index for index in range(len(SERVOS)) if index not in (mp, cmc)]] = (
                FREE_THUMB_FINGERS
            )
        else:
            highest[[mp, cmc]] = FREE_FINGERS_THUMB
        synergy = rng.uniform(hand.synergy_min, highest)
        while synergy[mp] > BLOCKED_MP and BLOCKED_CMC[0] < synergy[cmc] < BLOCKED_CMC[1]:
            synergy = rng.uniform(hand.synergy_min, highest)
        return GoalSetup(None, hand=hand, goal=joints_from_synergy(synergy, hand))

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        self.goal[np.asarray(worlds)] = [setup.goal for setup in setups]

    def judge(self, state: SceneState, dt: float) -> NDArray[np.int_]:
        """`RUNNING` for all episodes, shape (n,): a posture that is reached has to be held."""
        return np.full(len(state.time), RUNNING)

    def measure(self, achieved: Array, desired: Array) -> None:
        """Record the measured joint angles and the observed goal, shapes (n, 15) [rad]."""
        self._goals = achieved, desired

    def sparse_reward(self, now: Moment) -> Array:
        """0 where the posture is reached, −1 elsewhere, shape (n,)."""
        return self.goal_reward(*self._goals, False)

    def goal_reward(self, achieved: Array, desired: Array, dense: bool) -> Array:
        """The dense or the sparse reward of postures against goals, shapes (..., 15) [rad], for
        hindsight replay.

        Raises:
            ShapeError: Another shape.
        """
        reached = as_array(achieved, len(JOINTS), "achieved_goal")
        error = np.abs(reached - as_array(desired, len(JOINTS), "desired_goal"))
        if dense:
            return -error.mean(axis=-1)
        return (error.max(axis=-1) <= self.config.tolerance) - 1.0  # a NaN has not reached it

    def report(self, now: Moment) -> dict[str, Any]:
        largest = np.abs(np.subtract(*self._goals, dtype=float)).max(axis=1)
        return {"is_success": largest <= self.config.tolerance, "largest_error": largest}

    def script(self) -> Script:
        return ScriptedPosture()


class ScriptedPosture(Script):
    """Integral controller for `Posture`: moves to the goal, then corrects the command by the
    camera's measurements.

    It starts from the command that the servos have reached within their rate limit, so that a
    motion in progress is not corrected as an error.

    Args:
        near: largest distance of the command from the goal at which it is corrected [rad]; 0:
            never, a constant action.
    """

    def __init__(self, near: float = POSTURE_NEAR) -> None:
        self._near = near

    def act(self, observation: dict[str, NDArray[np.float32]]) -> NDArray[np.float32]:
        """The next action, shape (..., 6), for observations with any leading axes."""
        goal, reached = (
            observation[name][..., _DRIVEN].astype(float)
            for name in ("desired_goal", "achieved_goal")
        )
        command = observation["observation"][..., _COMMANDED].astype(float)
        synergy = np.where(
            np.abs(command - goal) < self._near, command + POSTURE_GAIN * (goal - reached), goal
        )
        return action_from_synergy(np.clip(synergy, HPAC.synergy_min, HPAC.synergy_max)).astype(
            np.float32
        )
