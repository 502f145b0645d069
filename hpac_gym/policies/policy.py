"""What a policy is, and one that was learned."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from hpac_gym.policies.closure import Closures
from hpac_gym.policies.policy_file import PolicyFile


class Policy(Protocol):
    """What acts. The same seed and the same observations give the same actions."""

    def reset(self, seed: int) -> None:
        """Forget the last episode; ``seed`` is the new one's."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The action for an observation, shape (6,), −1…1."""


class LearnedPolicy:
    """A trained actor without its exploration.

    Args:
        actor: from an observation, shape (n,), to an action, shape (6,), or with `closures` to the numbers of one, shape (m,);
            all −1…1; whatever computes it.
        action_repeat: control steps that each action is held for, at least 1; as in training.
        closures: with them the actor decides once, on the first observation of an episode; None for actions.
    """

    def __init__(
        self, actor: Callable[[np.ndarray], np.ndarray], action_repeat: int = 1, closures: Closures | None = None
    ) -> None:
        self._actor, self._action_repeat, self._closures = actor, action_repeat, closures

    @classmethod
    def of(cls, file: PolicyFile) -> LearnedPolicy:
        """The policy that a policy file holds."""
        return cls(file.actor, file.action_repeat, file.closures)

    def reset(self, seed: int) -> None:
        self._step = 0

    def act(self, observation: np.ndarray) -> np.ndarray:
        step, self._step = self._step, self._step + 1
        if self._closures is not None:
            if step == 0:
                self._decision = self._actor(observation)
            return self._closures.actions(self._decision[None], [step])[0].astype(np.float32)
        if step % self._action_repeat == 0:
            self._action = self._actor(observation)
        return self._action
