"""What a worker process of `GroupedVectorEnv` does: its environments in turn, one message in and one out for all of them.

A request is the name of a `Group`'s method and its arguments; an answer is `Answer`. Actions, observations, rewards and
ends lie in memory that the processes share, so that the messages of a step hold little but infos.
"""

from __future__ import annotations

import pickle
import signal
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import write_to_shared_memory
from numpy.typing import NDArray

from hpac_gym.envs.errors import EpisodeError

EnvFn = Callable[[], gymnasium.Env]


class Answer(NamedTuple):
    """What a worker says to a request."""

    value: Any
    """What the method returned."""
    error: Exception | None = None
    """What it raised instead."""
    place: int = 0
    """Of the environment that raised it."""
    trace: str = ""
    """Where that was, for a reader."""


@dataclass(frozen=True, slots=True)
class Buffers:
    """Memory that the processes share: a row for each environment."""

    actions: Any
    """Doubles, so that no caller's action is rounded on its way."""
    observations: Any
    """As `gymnasium.vector.utils.create_shared_memory` makes it."""
    rewards: Any
    terminated: Any
    truncated: Any

    def views(self, action_shape: tuple[int, ...]) -> tuple[NDArray[np.float64], NDArray, NDArray, NDArray]:
        """Actions, shape (num_envs, *action_shape); rewards, terminated, truncated, shape (num_envs,)."""
        return (
            np.frombuffer(self.actions, np.float64).reshape(-1, *action_shape),
            np.frombuffer(self.rewards, np.float64),
            np.frombuffer(self.terminated, np.bool_),
            np.frombuffer(self.truncated, np.bool_),
        )


class Group:
    """The environments of one worker. Every list that its methods take or return has one entry for each of them.

    Args:
        env_fn: makes one environment.
        places: where the environments stand in the whole vector.
        buffers: shared by all workers; a group reads and writes its own rows only.
        autoreset_mode: when an environment whose episode is over begins a new one.
    """

    def __init__(self, env_fn: EnvFn, places: range, buffers: Buffers, autoreset_mode: AutoresetMode) -> None:
        self.place = places.start
        """Of the environment that was dealt with last."""
        self._env_fn, self._places, self._buffers, self._mode = env_fn, places, buffers, autoreset_mode
        self._envs: list[gymnasium.Env] = []
        self._over = [False] * len(places)

    def make(self) -> None:
        """Make the environments."""
        for place in self._places:
            self.place = place
            self._envs.append(self._env_fn())
        self._actions, self._rewards, self._terminated, self._truncated = self._buffers.views(self._envs[0].action_space.shape)

    def reset(
        self, seeds: list[int | None], mask: NDArray[np.bool_], options: dict[str, Any] | None
    ) -> list[dict[str, Any] | None]:
        """Begin new episodes where `mask` says so; the infos, None where it does not."""
        infos: list[dict[str, Any] | None] = [None] * len(mask)
        for index, env in self._each():
            if mask[index]:
                observation, infos[index] = env.reset(seed=seeds[index], options=options)
                self._over[index] = False
                self._write(observation)
        return infos

    def step(self) -> list[dict[str, Any]]:
        """Carry out the actions that are in the buffer; the infos.

        Raises:
            EpisodeError: An episode is over, and the autoreset mode begins no new one.
        """
        return [self._step(index, env) for index, env in self._each()]

    def _step(self, index: int, env: gymnasium.Env) -> dict[str, Any]:
        place = self.place
        if self._over[index] and self._mode is AutoresetMode.DISABLED:
            raise EpisodeError("this episode is over: reset its environment with options={'reset_mask': ...}")
        if self._over[index]:
            observation, info = env.reset()
            reward, terminated, truncated = 0.0, False, False
        else:
            # A copy, since an environment may keep what it was given, and the next action takes this row.
            observation, reward, terminated, truncated, info = env.step(self._actions[place].copy())
        self._over[index] = bool(terminated or truncated)
        if self._over[index] and self._mode is AutoresetMode.SAME_STEP:
            final = {"final_obs": observation, "final_info": info}
            observation, info = env.reset()
            info = final | info
            self._over[index] = False
        self._rewards[place], self._terminated[place], self._truncated[place] = reward, terminated, truncated
        self._write(observation)
        return info

    def call(self, name: str, args: tuple[Any, ...], options: dict[str, Any]) -> list[Any]:
        """An attribute of every environment; what it returns if it is a method."""
        found = []
        for _, env in self._each():
            value = env.get_wrapper_attr(name)
            found.append(value(*args, **options) if callable(value) else value)
        return found

    def close(self) -> None:
        """Close every environment."""
        for env in self._envs:
            env.close()

    def _each(self) -> Iterator[tuple[int, gymnasium.Env]]:
        for index, place in enumerate(self._places):
            self.place = place
            yield index, self._envs[index]

    def _write(self, observation: Any) -> None:
        space = self._envs[0].observation_space
        write_to_shared_memory(space, self.place, observation, self._buffers.observations)


def portable(error: Exception) -> Exception:
    """The error itself if it comes through a pipe as it is, otherwise a RuntimeError with its name and message."""
    plain = RuntimeError(f"{type(error).__name__}: {error}")
    try:
        copy = pickle.loads(pickle.dumps(error))
    except Exception:
        return plain
    return error if type(copy) is type(error) and str(copy) == str(error) else plain


def answer(group: Group, name: str, arguments: tuple[Any, ...]) -> bytes:
    """A pickled `Answer`; one that names the error if the value cannot be pickled."""
    try:
        return pickle.dumps(Answer(getattr(group, name)(*arguments)))
    except Exception as error:
        return pickle.dumps(Answer(None, portable(error), group.place, traceback.format_exc()))


def serve(pipe: Connection, group: Group) -> None:
    """Make the environments, then answer requests until "close", or until the other end of the pipe is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches every process of a terminal: the parent decides
    try:
        pipe.send_bytes(answer(group, "make", ()))
        while (request := pipe.recv())[0] != "close":
            pipe.send_bytes(answer(group, *request))
    except (EOFError, ConnectionError):  # the parent is gone
        pass
    finally:
        group.close()
