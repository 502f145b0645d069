"""Untrained baseline policies."""

from __future__ import annotations

import gymnasium
import numpy as np

from hpac_gym.errors import PolicyError
from hpac_gym.tasks.grasp_types import GRASP_TYPES, GraspByType, ScriptedGraspType
from hpac_gym.tasks.posture import ScriptedPosture
from hpac_gym.tasks.scripted import Script, ScriptedClosure


class RandomPolicy:
    """Uniformly random actions, drawn at every control step."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._shape = env.action_space.shape

    def reset(self, seed: int) -> None:
        # A separate stream: the environment also uses default_rng(seed).
        self._rng = np.random.default_rng([seed, 1])

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._rng.uniform(-1, 1, self._shape).astype(np.float32)


class ScriptedPolicy:
    """The scripted closure of the environment's task, or a given one."""

    def __init__(self, env: gymnasium.Env, closure: Script | None = None) -> None:
        task = getattr(env.unwrapped, "task", None)  # environments of other packages have none
        self._closure = closure or (task.script() if task else ScriptedClosure())

    def reset(self, seed: int) -> None:
        self._closure.reset()

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._closure.act(observation)


def one_closure(env: gymnasium.Env, name: str) -> ScriptedPolicy:
    """The closure of one grasp type for all types, with each type's own wrist pose.

    Raises:
        PolicyError: The type is unknown, or the environment has no grasp types.
    """
    if name not in GRASP_TYPES:
        raise PolicyError(f"no grasp type '{name}': there are {', '.join(GRASP_TYPES)}")
    if not isinstance(env.unwrapped.task, GraspByType):
        raise PolicyError(f"one closure of {name} needs HPAC-GraspType-v0, not {env.spec.id}")
    return ScriptedPolicy(env, ScriptedGraspType(env.unwrapped.task, name))


def constant_posture(env: gymnasium.Env) -> ScriptedPolicy:
    """The constant action that moves the nominal hand to the goal of `HPAC-Posture-v1`."""
    return ScriptedPolicy(env, ScriptedPosture(near=0.0))


BASELINES = {"random": RandomPolicy, "scripted": ScriptedPolicy}
"""Baseline classes by name; each is constructed with an environment."""
