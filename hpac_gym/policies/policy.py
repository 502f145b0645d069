"""The policy protocol and the learned policy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from hpac_gym.policies.closure import Closures
from hpac_gym.policies.policy_file import PolicyFile


def vector(observation: np.ndarray | Mapping[str, np.ndarray]) -> np.ndarray:
    """An observation as a vector, shape (..., n): the entries of a dictionary in the order of its
    sorted names.
    """
    if isinstance(observation, Mapping):
        return np.concatenate([observation[name] for name in sorted(observation)], axis=-1)
    return observation


class Policy(Protocol):
    """A policy. The same seed and observations give the same actions."""

    def reset(self, seed: int) -> None:
        """Start a new episode; ``seed`` is its seed."""

    def act(self, observation: Any) -> np.ndarray:
        """The action for an observation of the environment, shape (6,), −1…1; shape (12,) with a
        free wrist.
        """


class LearnedPolicy:
    """A trained actor without its exploration.

    Args:
        actor: function of an observation's `vector`, shape (n,), that returns an action, shape
            (6,), or with `closures` the numbers of a closure, shape (m,); all −1…1.
        action_repeat: number of control steps for which each action is held, at least 1, as in
            training.
        closures: if given, the actor decides once, on the first observation of an episode; None if
            it sets actions.
    """

    def __init__(
        self,
        actor: Callable[[np.ndarray], np.ndarray],
        action_repeat: int = 1,
        closures: Closures | None = None,
    ) -> None:
        self._actor = actor
        self._action_repeat = action_repeat
        self._closures = closures

    @classmethod
    def of(cls, file: PolicyFile) -> LearnedPolicy:
        """The policy of a policy file."""
        return cls(file.actor, file.action_repeat, file.closures)

    def reset(self, seed: int) -> None:
        self._step = 0

    def act(self, observation: np.ndarray | Mapping[str, np.ndarray]) -> np.ndarray:
        step = self._step
        self._step = self._step + 1
        if self._closures is not None:
            if step == 0:
                self._decision = self._actor(vector(observation))
            return self._closures.actions(self._decision[None], [step])[0].astype(np.float32)
        if step % self._action_repeat == 0:
            self._action = self._actor(vector(observation))
        return self._action
