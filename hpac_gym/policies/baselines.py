"""Untrained baseline policies."""

from copy import copy, deepcopy
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import PolicyError
from hpac_gym.policies.made_for import id_of
from hpac_gym.policies.policy import EpisodePolicy, Memory
from hpac_gym.tasks.grasp_rules import GRASP_TYPES
from hpac_gym.tasks.grasp_types import GraspByType, ScriptedGraspType
from hpac_gym.tasks.posture import ScriptedPosture
from hpac_gym.tasks.scripted import Script, ScriptedClosure


class RandomPolicy(EpisodePolicy):
    """Uniformly random actions, drawn at every control step."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        self._shape = env.action_space.shape
        self.set_random_seed(0)

    def set_random_seed(self, seed: int) -> None:
        """Set the seed of the episodes that begin from now on."""
        self._seed = seed

    def _first(self, row: int) -> Memory:
        # A separate stream: the environment also uses default_rng(seed). Row 0's is that of [seed, 1].
        return np.random.default_rng([self._seed, 1, row])

    def _act(self, observation: Any, memory: Memory) -> tuple[NDArray[np.float32], Memory]:
        rng = deepcopy(memory)
        return rng.uniform(-1, 1, self._shape).astype(np.float32), rng


class ScriptedPolicy(EpisodePolicy):
    """The scripted closure of the environment's task, or a given one."""

    def __init__(self, env: gymnasium.Env[Any, Any], closure: Script | None = None) -> None:
        task = getattr(env.unwrapped, "task", None)  # environments of other packages have none
        self._closure = closure or (task.script() if task else ScriptedClosure())

    def _act(self, observation: Any, memory: Memory) -> tuple[NDArray[np.float32], Memory]:
        script = copy(memory or self._closure)
        if memory is None:
            script.reset()
        return script.act(observation), script


def one_closure(env: gymnasium.Env[Any, Any], name: str) -> ScriptedPolicy:
    """The closure of one grasp type for all types, with each type's own wrist pose.

    Raises:
        PolicyError: The type is unknown, or the environment has no grasp types.
    """
    if name not in GRASP_TYPES:
        raise PolicyError(f"no grasp type '{name}': there are {', '.join(GRASP_TYPES)}")
    task = getattr(env.unwrapped, "task", None)
    if not isinstance(task, GraspByType):
        raise PolicyError(f"one closure of {name} needs HPAC-GraspType-v0, not {id_of(env)}")
    return ScriptedPolicy(env, ScriptedGraspType(task, name))


def constant_posture(env: gymnasium.Env[Any, Any]) -> ScriptedPolicy:
    """The constant action that moves the nominal hand to the goal of `HPAC-Posture-v1`."""
    return ScriptedPolicy(env, ScriptedPosture(near=0.0))


BASELINES = {"random": RandomPolicy, "scripted": ScriptedPolicy}
"""Baseline classes by name; each is constructed with an environment."""
