"""What a policy is, and one that was learned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from hpac_gym.policies.policy_file import PolicyFile


class Policy(Protocol):
    """What acts. The same seed and the same observations give the same actions."""

    def reset(self, seed: int) -> None:
        """Forget the last episode; ``seed`` is the new one's."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The action for an observation, shape (6,), −1…1."""


class LearnedPolicy:
    """A trained actor without its exploration, which holds each action for as many control steps as in its training.

    Args:
        actor: the action for an observation, shape (n,) → shape (6,), −1…1; whatever computes it.
        action_repeat: control steps that each action is held for, at least 1.
    """

    def __init__(self, actor: Callable[[np.ndarray], np.ndarray], action_repeat: int) -> None:
        self._actor, self._action_repeat = actor, action_repeat

    @classmethod
    def of(cls, file: PolicyFile) -> LearnedPolicy:
        """The policy that a policy file holds."""
        return cls(file.actor, file.action_repeat)

    def reset(self, seed: int) -> None:
        self._step = 0

    def act(self, observation: np.ndarray) -> np.ndarray:
        if self._step % self._action_repeat == 0:
            self._action = self._actor(observation)
        self._step += 1
        return self._action
