"""The policies that nobody trained, which a trained one has to beat."""

from __future__ import annotations

import gymnasium
import numpy as np

from hpac_gym.envs import scripted_closure
from hpac_gym.policies.errors import PolicyError
from hpac_gym.tasks.grasp_types import GRASP_TYPES, GraspByType
from hpac_gym.tasks.scripted import Script, ScriptedGraspType, ScriptedPosture


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
    """The closure by rule that the environments bring for the task, or another one."""

    def __init__(self, env: gymnasium.Env, closure: Script | None = None) -> None:
        self._closure = closure or scripted_closure(getattr(env.unwrapped, "task", None))

    def reset(self, seed: int) -> None:
        self._closure.reset()

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._closure.act(observation)


def one_closure(env: gymnasium.Env, name: str) -> ScriptedPolicy:
    """The closure of one grasp type for all types, the wrist where each type's own data put it.

    Raises:
        PolicyError: No type has that name, or the environment asks for none.
    """
    if name not in GRASP_TYPES:
        raise PolicyError(f"no grasp type '{name}': there are {', '.join(GRASP_TYPES)}")
    if not isinstance(env.unwrapped.task, GraspByType):
        raise PolicyError(f"one closure of {name} needs HPAC-GraspType-v0, not {env.spec.id}")
    return ScriptedPolicy(env, ScriptedGraspType(env.unwrapped.task, name))


def constant_posture(env: gymnasium.Env) -> ScriptedPolicy:
    """The one action that takes the nominal hand to the goal of `HPAC-Posture-v1`."""
    return ScriptedPolicy(env, ScriptedPosture(gain=0.0))


BASELINES = {"random": RandomPolicy, "scripted": ScriptedPolicy}
"""By name; each is made for an environment."""
