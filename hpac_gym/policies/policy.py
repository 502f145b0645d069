"""The policy protocol and the learned policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpac_gym.errors import PolicyError
from hpac_gym.model.checks import as_finite_vector
from hpac_gym.policies.closure import Closures
from hpac_gym.policies.increments import Increments
from hpac_gym.policies.policy_file import PolicyFile

Observation = ArrayLike | Mapping[str, NDArray[Any]]
Memory = Any
"""What a policy remembers of one episode."""


def vector(observation: Observation) -> NDArray[Any]:
    """An observation as a vector, shape (..., n): the entries of a dictionary in the order of its
    sorted names.
    """
    if isinstance(observation, Mapping):
        return np.concatenate([observation[name] for name in sorted(observation)], axis=-1)
    return np.asarray(observation)


class Policy(Protocol):
    """A policy, with the interface of Stable-Baselines3's models.

    All that it remembers of an episode is in the state. One that draws random numbers also has
    `set_random_seed(seed)`, which is called before the first step of every episode: the same seed
    and observations give the same actions.
    """

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """The action for an observation.

        Args:
            observation: of one environment, or of n with a leading axis.
            state: what the last call of this episode returned; None begins an episode.
            episode_start: booleans, shape (n,): which environments begin an episode; None: as the
                state says.
            deterministic: without exploration.

        Returns:
            The action, −1…1, shape (6,) or (n, 6); with a free wrist longer. The next state.
        """


def ask(policy: Policy, observation: Any, state: Any, begins: Any) -> tuple[NDArray[Any], Any]:
    """What `Policy.predict` gives.

    Raises:
        PolicyError: It is no action with a state.
    """
    answer = policy.predict(observation, state, begins)
    if not (isinstance(answer, tuple) and len(answer) == 2 and answer[0] is not None):
        pair = isinstance(answer, tuple) and len(answer) == 2
        told = "(None, state)" if pair else type(answer).__name__
        raise PolicyError(
            f"predict of {type(policy).__name__} must return (action, state), not {told}"
        )
    return answer


class EpisodePolicy:
    """A policy without exploration that acts in every environment by itself; subclasses give
    `_act`.
    """

    def _act(self, observation: Any, memory: Memory) -> tuple[NDArray[Any], Memory]:
        """Action for an observation of one environment, and what to remember of the episode."""
        raise NotImplementedError

    def _first(self, row: int) -> Memory:
        """The memory before the first step in a row of a batch."""
        return None

    def predict(
        self,
        observation: Any,
        state: Sequence[Memory] | None = None,
        episode_start: ArrayLike | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], tuple[Memory, ...]]:
        """As in `Policy`; the state is a tuple with the memory of each environment."""
        named = isinstance(observation, Mapping)
        parts = list(observation.values()) if named else [observation]
        single = min(map(np.ndim, parts)) < 2
        if single:
            rows = [observation]
        elif named:
            rows = [dict(zip(observation, row, strict=True)) for row in zip(*parts, strict=True)]
        else:
            rows = list(observation)
        memories: Sequence[Memory] = [None] * len(rows) if state is None else state
        begins = np.zeros(len(rows)) if episode_start is None else np.reshape(episode_start, -1)
        memories = [
            self._first(row) if begun or state is None else memory
            for row, (begun, memory) in enumerate(zip(begins, memories, strict=True))
        ]
        acted = [self._act(row, memory) for row, memory in zip(rows, memories, strict=True)]
        actions = np.stack([action for action, _ in acted])
        return (actions[0] if single else actions), tuple(memory for _, memory in acted)


class LearnedPolicy(EpisodePolicy):
    """A trained actor without its exploration.

    Args:
        actor: function of an observation's `vector`, shape (n,), that returns an action, shape
            (6,), or with `closures` the numbers of a closure, shape (m,); all −1…1.
        action_repeat: number of control steps for which each action is held, at least 1, as in
            training.
        closures: if given, the actor decides once, on the first observation of an episode; None if
            it sets actions.
        increments: if given, the actor decides in every step how to move the hand from where it is,
            on what `Increments.shown` gives.
        size: n, if it is to be checked.
    """

    def __init__(
        self,
        actor: Callable[[NDArray[Any]], NDArray[np.float32]],
        action_repeat: int = 1,
        closures: Closures | None = None,
        increments: Increments | None = None,
        size: int | None = None,
    ) -> None:
        self._actor = actor
        self._size = size
        self._increments = increments
        self._action_repeat = action_repeat
        self._closures = closures

    @classmethod
    def of(cls, file: PolicyFile) -> LearnedPolicy:
        """The policy of a policy file."""
        return cls(file.actor, file.action_repeat, file.closures, file.increments, file.sizes[0])

    def _seen(self, observation: Observation) -> NDArray[Any]:
        seen = vector(observation)
        if self._size is not None:
            as_finite_vector(seen, self._size, "observation")
        return seen

    def _act(self, observation: Observation, memory: Memory) -> tuple[NDArray[Any], Memory]:
        if (moves := self._increments) is not None:
            seen = self._seen(observation)[None]
            recent = moves.begin(seen) if memory is None else moves.see(memory, seen)
            recent = moves.move(recent, self._actor(moves.shown(recent)[0])[None])
            return recent.action[0].astype(np.float32), recent
        step, decision = memory or (0, None)
        if decision is None or (self._closures is None and step % self._action_repeat == 0):
            decision = self._actor(self._seen(observation))
        action = decision
        if self._closures is not None:
            action = self._closures.actions(decision[None], [step])[0].astype(np.float32)
        return action, (step + 1, decision)
