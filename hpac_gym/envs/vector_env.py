"""Many hands as one Gymnasium vector environment: `Episodes` of n worlds."""

from collections.abc import Sequence
from types import MethodType
from typing import Any, ClassVar

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from hpac_gym.envs.commands import actions_of
from hpac_gym.envs.episodes import CONTROL_HZ, Episodes, open_episodes
from hpac_gym.envs.hand_env import GoalEnv, HandEnv
from hpac_gym.envs.options import RENDER_MODES, check_count, checked_options, setups_of
from hpac_gym.envs.randomization import randomization
from hpac_gym.envs.vector_infos import (
    begin,
    check_lengths,
    mask_of,
    of_last_step,
    of_step,
    seeds_of,
)
from hpac_gym.errors import EpisodeError, WorkspaceError
from hpac_gym.model.command import ACTION_TOLERANCE
from hpac_gym.physics.engine import Engine
from hpac_gym.tasks.task import RUNNING, Task

ATTRIBUTES = (
    "action_space",
    "dt",
    "hand",
    "model",
    "obs",
    "observation_space",
    "randomization",
    "render_mode",
    "slices",
    "spec",
    "task",
)
"""Attributes that `HandVectorEnv.get_attr` returns."""
METHODS = ("render", "compute_reward", "compute_terminated", "compute_truncated")
"""Methods that `HandVectorEnv.call` calls; all but the first are those of tasks with goals."""


def require(method: str, name: str, *known: str) -> None:
    """Refuse a name that is not known: an `AttributeError`."""
    if name not in known:
        raise AttributeError(f"{method}: {name!r} is not one of {', '.join(known)}")


class HandVectorEnv(VectorEnv[Any, NDArray, NDArray]):
    """n hands with a task, in one process, each to the bit like a `HandEnv` with the same seed.

    Args:
        task: draws episodes, judges them and shapes the reward.
        num_envs: n.
        autoreset_mode: when a finished environment is reset, as in Gymnasium's vector environments.
        max_episode_steps: truncates episodes; None leaves their length to the task.
        render_mode: None, "rgb_array", or "human", which shows the first environment.
        physics: an engine of n worlds instead of the one that the options name, for measurements.
        options: those of `HandEnv`, without `transmit`.

    Raises:
        TypeError: An unknown option.
        ParameterError: Wrong number of environments or steps, or an option that `HandEnv` refuses.
        ValueError: Unknown mode.

    Attributes:
        slices: slices of an observation vector, by field name.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": RENDER_MODES, "render_fps": CONTROL_HZ}

    def __init__(
        self,
        task: Task,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        physics: Engine | None = None,
        **options: Any,
    ) -> None:
        self._episodes: Episodes | None = None
        check_lengths(num_envs, max_episode_steps)
        self.task = task
        self.num_envs = num_envs
        self.render_mode = render_mode
        self._mode = AutoresetMode(autoreset_mode)
        self._limit = max_episode_steps or np.inf
        self.metadata = self.metadata | {"autoreset_mode": self._mode}
        chosen = checked_options(render_mode=render_mode, **options)
        self.hand = chosen.hand
        self.model = chosen.model
        self.obs = chosen.obs
        self.reward = chosen.reward
        if task.goal_terms:
            self.compute_reward = MethodType(GoalEnv.compute_reward, self)
            self.compute_terminated = MethodType(GoalEnv.compute_terminated, self)
            self.compute_truncated = self.compute_terminated
        self._episodes = Episodes(task, num_envs, chosen, engine=physics)
        self.dt = self._episodes.dt
        self.slices = self._episodes.observations.slices
        self.single_action_space = self._episodes.action_space
        self.single_observation_space = self._episodes.observations.space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._seeded = [seeding.np_random() for _ in range(num_envs)]
        self._over = np.ones(num_envs, dtype=bool)
        self._running = False

    __reduce_ex__ = HandEnv.__reduce_ex__
    episodes = property(open_episodes)
    # Of every environment, as in Gymnasium's own; the base class has a generator that nothing uses.
    np_random = property(lambda self: tuple(generator for generator, _ in self._seeded))
    np_random_seed = property(lambda self: tuple(seed for _, seed in self._seeded))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Start episodes.

        Args:
            seed: one seed per environment, or the first of consecutive seeds.
            options: those of `HandEnv.reset`, the same for all or a list with a setup or a goal for
                each; and `reset_mask`, shape (n,), to reset only some environments.

        Raises:
            ParameterError: Wrong seeds or mask, or an option that `HandEnv.reset` refuses.
        """
        episodes = self.episodes
        running = self._running and episodes.now is not None
        mask, options = mask_of(options, self.num_envs, running)
        seeds = seeds_of(seed, self.num_envs)
        self._running = False
        given = setups_of(options, self.task, self.hand, self.num_envs)
        worlds = np.flatnonzero(mask).tolist()
        for world in worlds:
            if seeds[world] is not None:
                self._seeded[world] = seeding.np_random(int(seeds[world]))
        infos: dict[str, Any] = {}
        self._restart(worlds, infos, given)
        self._running = True
        self.episodes.pictures.show()
        return episodes.observe(), infos

    def _restart(self, worlds: list[int], infos: dict[str, Any], given: Any = None) -> None:
        """Start episodes in some worlds, and add their infos."""
        generators = [self._seeded[world][0] for world in worlds]
        drawn = self.episodes.reset(worlds, generators, given and [given[at] for at in worlds])
        self._over[worlds] = False
        begin(infos, self.episodes, worlds, drawn, self._add_info)

    def step(self, actions: NDArray) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Carry out one action in every environment for one control period.

        Raises:
            ShapeError, WorkspaceError: Wrong shape, NaN, or an action that leaves −1…1.
            EpisodeError: Before `reset`, after `close`, or without autoreset after the end of an
                episode.
            PhysicsError: A world's simulation failed in PyBullet; the message names it.

        Warns:
            PhysicsWarning: A world's simulation failed in MuJoCo: its episode ends as a failure.
        """
        episodes = self.episodes
        waits = self._mode is AutoresetMode.DISABLED and self._over.any()
        if not self._running or episodes.now is None or waits:
            raise EpisodeError("no episode is running in every environment: call reset() first")
        actions = actions_of(actions, self.action_space, "actions")
        stale = self._over.copy()  # under NEXT_STEP these are reset, and their action is ignored
        actions = np.where(stale[:, None], 0.0, actions)
        try:
            rewards = np.asarray(episodes.step(actions), dtype=float)
        except WorkspaceError as error:
            world = int(np.argmin((np.abs(actions) <= 1.0 + ACTION_TOLERANCE).all(axis=1)))
            error.add_note(f"in environment {world}")
            raise
        self._running = False  # until the end: an interrupted step may have reset no world yet
        terminated = episodes.outcome != RUNNING
        truncated = episodes.wrists.step >= self._limit
        for ended in (rewards, terminated, truncated):
            ended[stale] = 0
        self._over = terminated | truncated
        infos = of_step(episodes, ~stale, terminated, self._add_info)
        worlds = np.flatnonzero(stale).tolist()
        if self._mode is AutoresetMode.SAME_STEP and self._over.any():
            worlds = np.flatnonzero(self._over).tolist()
            infos = of_last_step(episodes, self._over, terminated, self._add_info)
        if worlds:
            self._restart(worlds, infos)
        self._running = True
        self.episodes.pictures.show()
        return episodes.observe(), rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """RGB image of every environment; None without a render mode and with "human".

        Raises:
            EpisodeError: Before `reset`, or after `close`.
        """
        seen = self.episodes.pictures.render()
        return tuple(seen) if seen else None

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of each environment, as a `HandEnv` has it.

        Raises:
            AttributeError: `name` is not one of `ATTRIBUTES`.
        """
        require("get_attr", name, *ATTRIBUTES)
        if name == "randomization":
            return tuple(self.episodes.randomizations)
        name = f"single_{name}" if name.endswith("_space") else name
        return (getattr(self, name),) * self.num_envs

    def set_attr(self, name: str, values: Any) -> None:
        """Set the `randomization` of the next episodes: one for all, or a list with one for each.

        Raises:
            AttributeError: Any other name.
            ParameterError: Wrong number of values, or an invalid randomization.
        """
        require("set_attr", name, "randomization")
        values = values if isinstance(values, list | tuple) else [values] * self.num_envs
        check_count("values", values, self.num_envs)
        self.episodes.randomizations[:] = [randomization(value) for value in values]

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Results of one of `METHODS` in each environment, or the values of an attribute.

        Raises:
            AttributeError: Any other name.
        """
        methods = METHODS if self.task.goal_terms else METHODS[:1]
        require("call", name, *methods, *ATTRIBUTES)
        if name == "render":
            return self.render() or (None,) * self.num_envs
        if name in methods:
            return (getattr(self, name)(*args, **kwargs),) * self.num_envs
        return self.get_attr(name)

    def close_extras(self, **_: Any) -> None:
        """Release the physics; `close` calls this once."""
        HandEnv.close(self)
