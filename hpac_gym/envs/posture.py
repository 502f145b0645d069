"""HPAC-Posture-v0: bring fifteen joints to a posture with six servos; a goal environment for hindsight replay."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from hpac_gym.envs.errors import EpisodeError
from hpac_gym.envs.hand_env import CONTROL_HZ
from hpac_gym.envs.link import Link
from hpac_gym.envs.observation import COMMAND_FIELDS, Field, space_of, within
from hpac_gym.envs.options import RENDER_MODES, Reward, hand_of, require_options, reset_option
from hpac_gym.envs.randomization import Randomization, changed_mechanics, randomization
from hpac_gym.envs.views import FORCE_UNIT, IMAGE_SIZE, SPEED_UNIT, VIEW_TARGET, Obs, known
from hpac_gym.model import (
    HPAC,
    JOINTS,
    SERVO_INDEX,
    SERVOS,
    Hand,
    ServoCommand,
    elastic_joints_from_servo,
    joints_from_synergy,
)
from hpac_gym.model.checks import as_bounded_array, as_finite_vector
from hpac_gym.sim import Camera, HandSettings, SimHand, Stage
from hpac_gym.sim.scene import HAND_POSITION, HAND_QUATERNION, HAND_ROTATION
from hpac_gym.sim.world import refuse_copying

TOLERANCE = 0.05
"""A posture is reached when no joint is farther from it than this [rad]."""
CAMERA_NOISE = np.deg2rad(0.1)
"""Standard deviation of a joint angle that a camera measures from markers, as in the paper's experiment [rad]."""
FREE_THUMB_FINGERS = 0.35
"""Where the thumb may be anywhere, the fingers stay this far open, out of its way [rad]."""
FREE_FINGERS_THUMB = (0.5, 0.3)
"""Where the fingers may be anywhere, the thumb's MP and CMC stay below these, out of their way [rad]."""

FIELDS = COMMAND_FIELDS
PRIVILEGED_FIELDS = (
    Field("true_joint_pos", JOINTS, "rad", -0.5, 2.0, "true joint angle"),
    Field("true_joint_vel", JOINTS, "10 rad/s", -5.0, 5.0, "true joint speed"),
    Field("horn", SERVOS, "rad", 0.0, 2.0, "where the servo's horn is"),
    Field("tension", SERVOS[:-1], "10 N", 0.0, 10.0, "tension of the driving tendon"),
)
GOAL_FIELDS = (Field("joint_pos", JOINTS, "rad", -0.5, 2.0, "joint angle: achieved as a camera measures it, or desired"),)

Goal = NDArray[np.float32]


class PostureEnv(gymnasium.Env[dict[str, NDArray], NDArray[np.float32]]):
    """The hand alone, palm to the side; no object, no wrist. The wire's way in is that of `HandEnv`.

    Args:
        hand: the hand's parameters, or a hand file.
        reward: "dense" for minus the mean joint error [rad], "sparse" for −1 until the posture is reached and 0 then.
        render_mode: None or "rgb_array".
        obs: "deploy" for the command and the model's prediction, "privileged" for the true state after them, "image" for a
            picture beside them.
        randomize: what else differs between episodes: a preset of `hpac_gym.envs.randomization.PRESETS`, a
            `Randomization`, or ranges by name; None is "nominal", which changes nothing. What
            concerns an object changes nothing here.

    Raises:
        ParameterError: An unknown reward, render mode, obs or randomize, or a bad hand file.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": CONTROL_HZ}
    __reduce_ex__ = refuse_copying

    def __init__(
        self,
        hand: Hand | str | PathLike[str] = HPAC,
        reward: Reward = "dense",
        render_mode: str | None = None,
        obs: Obs = "deploy",
        randomize: Randomization | Mapping | str | None = None,
    ) -> None:
        require_options(reward, render_mode)
        self.reward, self.render_mode, self.obs = reward, render_mode, known(obs)
        self.randomization = randomization(randomize)
        self.hand = hand_of(hand)
        self._space = space_of((*FIELDS, *PRIVILEGED_FIELDS) if obs == "privileged" else FIELDS)
        self._goal_space = space_of(GOAL_FIELDS)
        parts = {"observation": self._space, "achieved_goal": self._goal_space, "desired_goal": self._goal_space}
        if obs == "image":
            parts["image"] = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        self.observation_space = spaces.Dict(parts)
        self.action_space = spaces.Box(-1.0, 1.0, (len(SERVOS),), np.float32)
        self.dt = 1.0 / CONTROL_HZ
        self.transmit: Callable[[ServoCommand], ServoCommand] = lambda command: command
        visuals = render_mode is not None or obs == "image"
        self._stage: Stage | None = Stage("hpac_hand.urdf", tuple(HAND_POSITION), visuals=visuals)
        self._body: SimHand | None = None

    @property
    def command(self) -> ServoCommand:
        """The last command that went to the servos."""
        return self._link.command

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray], dict[str, Any]]:
        """Start an episode with the open hand.

        Args:
            seed: of the environment's generator. Same seed, same episode, to the bit.
            options: `{"goal": posture}`, shape (15,) [rad], gives the goal instead of drawing it.

        Raises:
            ParameterError: Another option.
            ShapeError: A goal of the wrong shape, with NaN or infinity.
            WorkspaceError: A goal that leaves the bounds of the observation.
        """
        self._body = None
        given = reset_option(options, "goal")
        if given is not None:
            given = self._admissible(given)
        super().reset(seed=seed)
        goal_rng, self._camera_rng = self.np_random.spawn(2)
        drawn = self.randomization.draw(goal_rng)
        simulated, settings = changed_mechanics(self.hand, HandSettings(), drawn)
        goal = joints_from_synergy(self._goal_synergy(goal_rng), self.hand)
        self._goal = within(self._goal_space, goal if given is None else given)
        self._body = self.stage.start(simulated, settings, HAND_QUATERNION)
        self._body.reset(np.zeros(len(SERVOS)))
        self._noise = CAMERA_NOISE * float(drawn.get("sensor_noise", [1.0])[0])
        self._link = Link(self.hand, np.zeros(len(SERVOS)), self.dt, drawn, goal_rng)
        observation = self._observe()
        return observation, self._info(observation) | {"randomized": {name: list(v) for name, v in drawn.items()}}

    def step(self, action: NDArray[np.float32]) -> tuple[dict[str, NDArray], float, bool, bool, dict[str, Any]]:
        """Carry out one action for one control period. An episode has no end but the time limit.

        Raises:
            ShapeError: `action` has the wrong shape.
            WorkspaceError: `action` has NaN, or leaves −1…1.
            EpisodeError: Before `reset`, or after `close`.
        """
        self.stage  # noqa: B018  a closed environment says so first
        if self._body is None:
            raise EpisodeError("no episode is running: call reset() first")
        self._body.command(self._link.send(action, self.transmit))
        self._body.step(self.dt)
        observation = self._observe()
        info = self._info(observation)
        reward = self.compute_reward(observation["achieved_goal"], observation["desired_goal"], info)
        return observation, float(reward), False, False, info

    def compute_reward(self, achieved_goal: Goal, desired_goal: Goal, info: Any) -> NDArray[np.float64]:
        """The reward of postures against goals, shapes (..., 15) [rad]; `info` is not looked at."""
        error = np.abs(np.asarray(achieved_goal, dtype=float) - desired_goal)
        return -error.mean(axis=-1) if self.reward == "dense" else -(error.max(axis=-1) > TOLERANCE).astype(float)

    def compute_terminated(self, achieved_goal: Goal, desired_goal: Goal, info: Any) -> NDArray[np.bool_]:
        """Whether postures end an episode, shapes (..., 15) [rad]: never, a posture that is reached is to be kept."""
        return np.zeros(np.broadcast_shapes(np.shape(achieved_goal), np.shape(desired_goal))[:-1], dtype=bool)[()]

    def compute_truncated(self, achieved_goal: Goal, desired_goal: Goal, info: Any) -> NDArray[np.bool_]:
        """Whether postures cut an episode short, shapes (..., 15) [rad]: never, that is the time limit's business."""
        return self.compute_terminated(achieved_goal, desired_goal, info)

    def _admissible(self, goal: ArrayLike) -> NDArray[np.float64]:
        low, high = (bound.astype(float) for bound in (self._goal_space.low, self._goal_space.high))
        return as_bounded_array(as_finite_vector(goal, len(JOINTS), "goal"), low, high, JOINTS, "goal", "rad")

    def _goal_synergy(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Half of the goals move the thumb freely and half the fingers, since one can stand in the other's way."""
        free_thumb = rng.random() < 0.5
        highest = self.hand.synergy_max.copy()
        mp, cmc = SERVO_INDEX["thumb_mp"], SERVO_INDEX["thumb_cmc"]
        if free_thumb:
            highest[[index for index in range(len(SERVOS)) if index not in (mp, cmc)]] = FREE_THUMB_FINGERS
        else:
            highest[[mp, cmc]] = FREE_FINGERS_THUMB
        return rng.uniform(self.hand.synergy_min, highest)

    def _observe(self) -> dict[str, NDArray]:
        servo, body = self._link.command.servo, self._body
        joint_pos, joint_vel = body.joint_state()
        parts = [servo, elastic_joints_from_servo(servo, self.hand)]
        if self.obs == "privileged":
            parts += [joint_pos, joint_vel / SPEED_UNIT, body.servos.horn, np.array(body.tension) / FORCE_UNIT]
        seen = joint_pos + self._noise * self._camera_rng.standard_normal(len(JOINTS))
        observation = {
            "observation": within(self._space, np.concatenate(parts)),
            "achieved_goal": within(self._goal_space, seen),
            "desired_goal": self._goal.copy(),
        }
        if self.obs == "image":
            observation["image"] = self._picture(Camera(width=IMAGE_SIZE, height=IMAGE_SIZE))
        return observation

    def _info(self, observation: dict[str, NDArray]) -> dict[str, Any]:
        error = float(np.abs(observation["achieved_goal"] - observation["desired_goal"]).max())
        return {"is_success": error <= TOLERANCE, "largest_error": error}

    def _picture(self, camera: Camera) -> NDArray[np.uint8]:
        return camera.picture(self.stage.world, HAND_POSITION + HAND_ROTATION @ VIEW_TARGET)

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, shape (360, 480, 3), or None without a render mode.

        Raises:
            EpisodeError: Before `reset`, or after `close`.
        """
        self.stage  # noqa: B018
        if self.render_mode is None:
            return None
        if self._body is None:
            raise EpisodeError("nothing to render: call reset() first")
        return self._picture(Camera())

    @property
    def stage(self) -> Stage:
        """The physics below.

        Raises:
            EpisodeError: The environment is closed.
        """
        if self._stage is None:
            raise EpisodeError("this environment is closed: make a new one")
        return self._stage

    def close(self) -> None:
        """Leave the physics client. Closing twice is no error."""
        if self._stage is not None:
            self._stage.close()
        self._stage = None
