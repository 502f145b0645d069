"""One hand as a Gymnasium environment: `Episodes` of a single world."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, NoReturn, SupportsIndex

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hpac_gym.envs.episodes import CONTROL_HZ, VIEW_TARGET, Episodes, Transmit
from hpac_gym.envs.options import RENDER_MODES, checked_options, setup_of
from hpac_gym.envs.randomization import Randomization, randomization
from hpac_gym.errors import EpisodeError, ParameterError, ShapeError
from hpac_gym.model import ServoCommand
from hpac_gym.model.checks import Array, as_array
from hpac_gym.physics.engine import SceneState, Viewpoint
from hpac_gym.tasks.config import settings_from
from hpac_gym.tasks.posture import Posture, PostureConfig
from hpac_gym.tasks.task import RUNNING, Task

Observation = NDArray[np.float32] | dict[str, NDArray]


class HandEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """A hand with a task; six actions a step, one `ServoCommand` each. The task moves the wrist.

    Args:
        task: draws episodes, judges them and shapes the reward.
        render_mode: None, "rgb_array" or "human".
        transmit: what a command passes through on its way to the simulated servos, such as the wire and the firmware; None
            leaves it as it is. Observations keep to what was commanded.
        options: hand, reward, noise, obs, randomize, engine, body: `hpac_gym.envs.options.OPTIONS` says what
            they mean.

    Raises:
        TypeError: An unknown option.
        ParameterError: An unknown value, a bad hand file, or an engine that is not installed.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": CONTROL_HZ}

    def __init__(
        self, task: Task, render_mode: str | None = None, transmit: Transmit | None = None, **options: Any
    ) -> None:
        self.task, self.render_mode, self._transmit = task, render_mode, transmit
        chosen = checked_options(render_mode=render_mode, **options)
        self.hand, self.obs = chosen.hand, chosen.obs
        self._episodes: Episodes | None = Episodes(task, 1, chosen, transmit)
        self.observation_space, self.action_space = self._episodes.observation_space, self._episodes.action_space
        self.dt = self._episodes.dt
        self._running = False

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse copies, which would step and close the original's physics.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"a physics world cannot be copied or pickled: make a new {type(self).__name__}")

    @property
    def episodes(self) -> Episodes:
        """What runs below. For figures and tests; a policy must not look.

        Raises:
            EpisodeError: The environment is closed.
        """
        if self._episodes is None:
            raise EpisodeError("this environment is closed: make a new one")
        return self._episodes

    @property
    def randomization(self) -> Randomization:
        """What differs between episodes beside the task's own draw. What is put here counts from the next `reset` on."""
        return self.episodes.randomizations[0]

    @randomization.setter
    def randomization(self, given: Randomization | Mapping | str | None) -> None:
        self.episodes.randomizations[0] = randomization(given)

    @property
    def state(self) -> SceneState:
        """The true state of the scene after the last step; arrays with a leading axis of one. A policy must not look."""
        return self._begun().now.state

    @property
    def phase(self) -> str:
        """What the wrist is doing: one of the task's `phases`."""
        return self.task.phases[self._begun().now.phase[0]]

    @property
    def slices(self) -> dict[str, slice]:
        """Where the entries of each field are in the observed vector, by the field's name."""
        return self.episodes.slices

    @property
    def command(self) -> ServoCommand:
        """The last command that went to the servos: what a bridge sends to the real hand."""
        return self._begun().command

    def _begun(self) -> Episodes:
        if self.episodes.now is None:
            raise EpisodeError("no episode is running: call reset() first")
        return self.episodes

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Start an episode.

        Args:
            seed: of the environment's generator. Same seed, same episode, to the bit.
            options: `{"setup": SceneSetup}` gives the episode instead of drawing it; for a task with goals `{"goal": posture}`,
                shape (15,) [rad].

        Raises:
            ParameterError: Another option, or a setup that is none.
            ShapeError: A setup or goal with an array of the wrong shape, NaN or infinity.
            WorkspaceError: A goal that leaves the bounds of the observation.
        """
        self._running = False
        given = setup_of(options, self.task, self.hand)
        super().reset(seed=seed)
        drawn = self.episodes.reset([0], [self.np_random], given)[0]
        self._running = True
        if self.render_mode == "human":
            self.episodes.show()
        return self._observe(), self._info() | {"randomized": {name: list(value) for name, value in drawn.items()}}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Carry out one action for one control period.

        Raises:
            ShapeError: `action` has the wrong shape.
            WorkspaceError: `action` has NaN, or leaves −1…1: wrap in `gymnasium.wrappers.ClipAction`.
            EpisodeError: Before `reset`, after the end of an episode, or after `close`.
            PhysicsError: The simulation failed.
        """
        episodes = self.episodes
        if not self._running:
            raise EpisodeError("no episode is running: call reset() first")
        (size,) = self.action_space.shape
        action = as_array(action, size, "action")
        if action.ndim != 1:
            raise ShapeError(f"action must have shape ({size},), not {action.shape}")
        reward = float(episodes.step(action[None])[0])
        self._running = bool(episodes.outcome[0] == RUNNING)
        if self.render_mode == "human":
            self.episodes.show()
        return self._observe(), reward, not self._running, False, self._info()

    def save_state(self) -> Any:
        """The state of the episode, for `restore_state`: physics, servos, task, camera and random generators.

        Wrappers keep their own: while planning, step `env.unwrapped`.

        Raises:
            EpisodeError: Before `reset`, after `close`, or with `transmit`, whose far end has a state of its own.
        """
        if self._transmit is not None:
            raise EpisodeError("a state cannot be saved with transmit: what is at the far end keeps its own")
        return self._running, self._begun().save()

    def restore_state(self, state: Any) -> None:
        """Go back to a state that `save_state` gave, as often as wanted: the same actions give the same steps, to the bit.

        Raises:
            EpisodeError: The state is of another episode, or of another environment; or after `close`.
        """
        running, snapshot = state
        self._begun().restore(snapshot)
        self._running = running

    def _observe(self) -> Observation:
        seen = self.episodes.observe()
        return {name: part[0] for name, part in seen.items()} if isinstance(seen, dict) else seen[0]

    def _info(self) -> dict[str, Any]:
        episodes = self.episodes
        info = {name: values.tolist()[0] for name, values in episodes.report().items()}
        if not self.task.goal_terms:
            info["reward_terms"] = {name: float(values[0]) for name, values in episodes.terms.items()} if episodes.terms else {}
        if episodes.outcome[0] != RUNNING:
            info["epsilon"] = episodes.quality(0)
        return info

    def render(self) -> NDArray[np.uint8] | None:
        """A picture, shape (360, 480, 3); None without a render mode, and with "human", which shows every step by itself.

        Raises:
            EpisodeError: Before `reset`, or after `close`.
        """
        episodes = self.episodes
        if self.render_mode is None:
            return None
        if episodes.now is None:
            raise EpisodeError("nothing to render: call reset() first")
        return episodes.picture(0) if self.render_mode == "rgb_array" else None

    def picture(self, viewpoint: Viewpoint, centre: Array = VIEW_TARGET) -> NDArray[np.uint8]:
        """A picture from anywhere, with a point of the hand frame, shape (3,) [m], in the middle; needs a render mode."""
        return self._begun().picture(0, viewpoint, centre)

    def close(self) -> None:
        """Free the physics. Closing twice is no error."""
        if self._episodes is not None:
            self._episodes.close()
        self._episodes, self._running = None, False


def posture_task(config: PostureConfig | Mapping | None = None, reachable: bool = False) -> Posture:
    """The task of `HPAC-Posture-v0`, and with `reachable` that of v1.

    Args:
        config: what episodes are judged by, or a mapping of its fields; None is the default.
        reachable: as for `Posture`.

    Raises:
        ParameterError: A config that is none, or one with another duration, which is the time limit's business.
    """
    chosen = settings_from(PostureConfig(), config, "config")
    if chosen.duration != PostureConfig().duration:
        raise ParameterError(f"config duration = {chosen.duration} s: give gymnasium.make(..., max_episode_steps=) instead")
    return Posture(chosen, reachable)


class PostureEnv(HandEnv):
    """`HandEnv` with the functions that hindsight replay needs. Goals are joint angles, shape (..., 15) [rad].

    Args:
        config: as for `posture_task`.
        reachable: as for `Posture`.
        options: those of `HandEnv`.
    """

    def __init__(self, config: PostureConfig | Mapping | None = None, reachable: bool = False, **options: Any) -> None:
        super().__init__(posture_task(config, reachable), **options)

    def compute_reward(self, achieved_goal: NDArray, desired_goal: NDArray, info: Any) -> NDArray[np.float64]:
        """The reward of postures against goals; `info` is not looked at."""
        return self.task.goal_reward(achieved_goal, desired_goal, self.episodes.options.reward == "dense")

    def compute_terminated(self, achieved_goal: NDArray, desired_goal: NDArray, info: Any) -> NDArray[np.bool_]:
        """Whether postures end an episode: never, a posture that is reached is to be kept."""
        return np.zeros(np.broadcast_shapes(np.shape(achieved_goal), np.shape(desired_goal))[:-1], dtype=bool)[()]

    def compute_truncated(self, achieved_goal: NDArray, desired_goal: NDArray, info: Any) -> NDArray[np.bool_]:
        """Whether postures cut an episode short: never, that is the time limit's business."""
        return self.compute_terminated(achieved_goal, desired_goal, info)
