"""The environments. `import hpac_gym` registers them."""

from __future__ import annotations

from hpac_gym.envs.grasp import Grasp
from hpac_gym.envs.hand_env import HandEnv
from hpac_gym.envs.pick_place import PickPlace, ScriptedPickPlace
from hpac_gym.envs.posture import PostureEnv
from hpac_gym.envs.scripted import ScriptedClosure

__all__ = ["Grasp", "HandEnv", "PickPlace", "PostureEnv", "ScriptedClosure", "ScriptedPickPlace", "grasp", "pick_place"]


def grasp(**options: object) -> HandEnv:
    """`HPAC-Grasp-v0`; options are those of `HandEnv`."""
    return HandEnv(Grasp(), **options)


def pick_place(**options: object) -> HandEnv:
    """`HPAC-PickPlace-v0`; options are those of `HandEnv`."""
    return HandEnv(PickPlace(), **options)
