"""The environments. `import hpac_gym` registers them."""

from __future__ import annotations

from hpac_gym.envs.grasp import Grasp
from hpac_gym.envs.grasp_data import GRASPS, NOMINAL, GraspError
from hpac_gym.envs.hand_env import HandEnv
from hpac_gym.envs.named import GraspByName
from hpac_gym.envs.pick_place import PickPlace
from hpac_gym.envs.posture import PostureEnv
from hpac_gym.envs.scripted import ScriptedClosure, ScriptedPickPlace, scripted_closure

__all__ = [
    "GRASPS",
    "Grasp",
    "GraspByName",
    "GraspError",
    "HandEnv",
    "PickPlace",
    "PostureEnv",
    "ScriptedClosure",
    "ScriptedPickPlace",
    "grasp",
    "pick_place",
    "scripted_closure",
]


def grasp(grasp: str | None = None, variant: str = NOMINAL, **options: object) -> HandEnv:
    """`HPAC-Grasp-v0`.

    Args:
        grasp: one of the sixteen of `GRASPS` by its name; None draws a primitive of any size in front of the open hand.
        variant: of a named grasp's object, such as "large" or "slippery"; see `data/grasps.toml`.
        options: those of `HandEnv`.

    Raises:
        GraspError: No grasp or variant has that name, or a variant of no named grasp is asked for.
    """
    if grasp is not None:
        return HandEnv(GraspByName(grasp, variant), **options)
    if variant != NOMINAL:
        raise GraspError(f"variant {variant!r} needs a named grasp: grasp=NAME")
    return HandEnv(Grasp(), **options)


def pick_place(**options: object) -> HandEnv:
    """`HPAC-PickPlace-v0`; options are those of `HandEnv`."""
    return HandEnv(PickPlace(), **options)
