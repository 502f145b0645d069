"""Vector environments in a few processes: what ``gymnasium.make_vec`` makes of this library's ids.

PyBullet does not let go of Python's lock, so that environments step at the same time only in processes of their own. One
process each is more than the processor has cores for: here there are as many as cores, each with its share of the
environments, and a step costs each of them one message in and one out.
"""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from copy import deepcopy
from ctypes import c_bool, c_double
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space, create_shared_memory, read_from_shared_memory
from numpy.typing import ArrayLike, NDArray

from hpac_gym.envs.errors import EpisodeError
from hpac_gym.envs.vector_group import Buffers, EnvFn
from hpac_gym.envs.vector_workers import CONTEXT, Workers, shares
from hpac_gym.errors import ParameterError, ShapeError
from hpac_gym.model.checks import as_array


class GroupedVectorEnv(VectorEnv[Any, NDArray, NDArray]):
    """Environments of one kind in a few processes. Each does, to the bit, what it would do alone with the same seed.

    What an environment raises is raised here as well, with a note of its place; until the next `reset` the others may then
    be a step ahead. Processes are spawned: a script keeps its work under ``if __name__ == "__main__":``.

    Args:
        env_fn: makes one environment.
        num_envs: how many.
        workers: processes; None for one for each processor core. There are never more than `num_envs`.
        autoreset_mode: when an environment whose episode is over begins a new one, as in Gymnasium's vector environments.

    Raises:
        ParameterError: `num_envs` or `workers` is below 1, or there is no such autoreset mode.
        WorkerError: A process has ended on its own: here, or in any later call.
    """

    def __init__(
        self,
        env_fn: EnvFn,
        num_envs: int = 1,
        workers: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self._workers: Workers | None = None
        workers = len(os.sched_getaffinity(0)) if workers is None else workers
        if num_envs < 1 or workers < 1:
            raise ParameterError(f"num_envs = {num_envs} and workers = {workers} must be at least 1")
        if autoreset_mode not in list(AutoresetMode) + [mode.value for mode in AutoresetMode]:
            raise ParameterError(f"autoreset_mode {autoreset_mode!r} is none of {[mode.value for mode in AutoresetMode]}")
        mode = AutoresetMode(autoreset_mode)
        self.num_envs = num_envs
        with env_fn() as env:
            self.metadata, self.render_mode = env.metadata | {"autoreset_mode": mode}, env.render_mode
            self.single_action_space, self.single_observation_space = env.action_space, env.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        buffers = Buffers(
            actions=CONTEXT.RawArray(c_double, math.prod(self.action_space.shape)),
            observations=create_shared_memory(self.single_observation_space, num_envs, CONTEXT),
            rewards=CONTEXT.RawArray(c_double, num_envs),
            terminated=CONTEXT.RawArray(c_bool, num_envs),
            truncated=CONTEXT.RawArray(c_bool, num_envs),
        )
        self._actions, *self._results = buffers.views(self.single_action_space.shape)
        self._observations = read_from_shared_memory(self.single_observation_space, buffers.observations, num_envs)
        self._places = shares(num_envs, min(workers, num_envs))
        self._workers = Workers(env_fn, self._places, buffers, mode)

    @property
    def processes(self) -> list[int]:
        """The ids of the worker processes.

        Raises:
            EpisodeError: After `close`.
        """
        return [process.pid for process in self._open().processes]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes.

        Args:
            seed: of the environment at place 0, each next place one more; or one for each place; None goes on drawing.
            options: of every environment's `reset`; with `reset_mask`, booleans, shape (num_envs,), only the environments
                that it marks are reset.

        Raises:
            ShapeError: A mask or seeds not of `num_envs` entries, or a mask that marks none.
            EpisodeError: After `close`.
        """
        options = None if options is None else dict(options)
        everyone = np.ones(self.num_envs, np.bool_)
        mask = everyone if options is None else np.asarray(options.pop("reset_mask", everyone))
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ShapeError(f"reset_mask must be booleans of shape ({self.num_envs},) that mark at least one, not {mask!r}")
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, int | np.integer):
            seeds = [int(seed) + place for place in range(self.num_envs)]
        else:
            seeds = list(seed)
        if len(seeds) != self.num_envs:
            raise ShapeError(f"{len(seeds)} seeds for {self.num_envs} environments")
        infos = self._open().ask("reset", [(seeds[p.start : p.stop], mask[p.start : p.stop], options) for p in self._places])
        return deepcopy(self._observations), self._merged(infos)

    def step(self, actions: ArrayLike) -> tuple[Any, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Carry out one action in every environment.

        Args:
            actions: shape (num_envs, 6), −1…1.

        Returns:
            Observations; rewards, terminated, truncated, shape (num_envs,); infos in Gymnasium's vector format.

        Raises:
            ShapeError: `actions` has the wrong shape.
            WorkspaceError: An action has NaN, or leaves −1…1.
            EpisodeError: After `close`, or after an episode's end where no new one begins by itself.
        """
        actions, workers = as_array(actions, self._actions.shape[-1], "actions"), self._open()
        if actions.shape != self._actions.shape:
            raise ShapeError(f"actions must have the shape {self._actions.shape}, not {actions.shape}")
        self._actions[:] = actions
        infos = self._merged(workers.ask("step", [()] * len(self._places)))
        rewards, terminated, truncated = (result.copy() for result in self._results)
        return deepcopy(self._observations), rewards, terminated, truncated, infos

    def call(self, name: str, *args: Any, **options: Any) -> tuple[Any, ...]:
        """An attribute of every environment, or what it returns where it is a method.

        Raises:
            EpisodeError: After `close`.
        """
        return tuple(self._open().ask("call", [(name, args, options)] * len(self._places)))

    def render(self) -> tuple[NDArray[np.uint8] | None, ...]:
        """A picture of every environment, or None each without a render mode.

        Raises:
            EpisodeError: After `close`.
        """
        return self.call("render")

    def close_extras(self, **_: object) -> None:
        """End the processes; `close` calls this once."""
        if self._workers is not None:
            self._workers.close()

    def _merged(self, infos: list[dict[str, Any] | None]) -> dict[str, Any]:
        merged: dict[str, Any] = {}
        for place, info in enumerate(infos):
            merged = merged if info is None else self._add_info(merged, info, place)
        return merged

    def _open(self) -> Workers:
        if self.closed or self._workers is None:
            raise EpisodeError("this vector environment is closed: make a new one")
        return self._workers

    def __del__(self) -> None:
        self.close()


def grouped(
    env_id: str,
    num_envs: int,
    workers: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    **options: Any,
) -> GroupedVectorEnv:
    """Environments of a registered id; `options` are those of ``gymnasium.make``."""
    return GroupedVectorEnv(partial(gymnasium.make, env_id, **options), num_envs, workers, autoreset_mode)


def grasp(num_envs: int, **options: Any) -> GroupedVectorEnv:
    """`HPAC-Grasp-v0`; options of `grouped` and of the id."""
    return grouped("HPAC-Grasp-v0", num_envs, **options)


def pick_place(num_envs: int, **options: Any) -> GroupedVectorEnv:
    """`HPAC-PickPlace-v0`; options of `grouped` and of the id."""
    return grouped("HPAC-PickPlace-v0", num_envs, **options)


def posture(num_envs: int, **options: Any) -> GroupedVectorEnv:
    """`HPAC-Posture-v0`; options of `grouped` and of the id."""
    return grouped("HPAC-Posture-v0", num_envs, **options)
