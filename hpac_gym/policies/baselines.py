"""The policies that nobody trained, which a trained one has to beat."""

from __future__ import annotations

import gymnasium
import numpy as np

from hpac_gym.envs import scripted_closure


class RandomPolicy:
    """Uniform actions, anew at every control step."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._shape = env.action_space.shape

    def reset(self, seed: int) -> None:
        # A stream of its own: the environment draws from default_rng(seed) too.
        self._rng = np.random.default_rng([seed, 1])

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._rng.uniform(-1, 1, self._shape).astype(np.float32)


class ScriptedPolicy:
    """The closure by rule that the environments bring for the task."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._closure = scripted_closure(getattr(env.unwrapped, "task", None))

    def reset(self, seed: int) -> None:
        self._closure.reset()

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._closure.act(observation)


BASELINES = {"random": RandomPolicy, "scripted": ScriptedPolicy}
"""By name; each is made for an environment."""
