"""The environments. `import hpac_gym` registers them."""

from __future__ import annotations

from hpac_gym.envs.grasp import Grasp
from hpac_gym.envs.hand_env import HandEnv
from hpac_gym.envs.scripted import ScriptedClosure

__all__ = ["Grasp", "HandEnv", "ScriptedClosure", "grasp"]


def grasp(**options: object) -> HandEnv:
    """`HPAC-Grasp-v0`; options are those of `HandEnv`."""
    return HandEnv(Grasp(), **options)
