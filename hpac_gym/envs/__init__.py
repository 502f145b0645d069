"""The environments. `import hpac_gym` registers them."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, VectorEnv

from hpac_gym.envs.hand_env import HandEnv, PostureEnv
from hpac_gym.envs.options import GRASP, PICK_PLACE, POSTURE
from hpac_gym.envs.vector_env import HandVectorEnv
from hpac_gym.errors import ParameterError
from hpac_gym.physics.simulation import default_engine
from hpac_gym.tasks.grasp import Grasp, GraspByName
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL, GraspError
from hpac_gym.tasks.pick_place import PickPlace
from hpac_gym.tasks.posture import Posture
from hpac_gym.tasks.scripted import ScriptedClosure, ScriptedPickPlace, scripted_closure
from hpac_gym.tasks.task import Task

__all__ = [
    "GRASPS",
    "Grasp",
    "GraspByName",
    "GraspError",
    "HandEnv",
    "HandVectorEnv",
    "PickPlace",
    "Posture",
    "PostureEnv",
    "ScriptedClosure",
    "ScriptedPickPlace",
    "scripted_closure",
]


def grasp_task(grasp: str | None = None, variant: str = NOMINAL) -> Task:
    """The task of `HPAC-Grasp-v0`.

    Args:
        grasp: one of the sixteen of `GRASPS` by its name; None draws a primitive of any size in front of the open hand.
        variant: of a named grasp's object, such as "large" or "slippery"; see `tasks/data/grasps.toml`.

    Raises:
        GraspError: No grasp or variant has that name, or a variant of no named grasp is asked for.
    """
    if grasp is not None:
        return GraspByName(grasp, variant)
    if variant != NOMINAL:
        raise GraspError(f"variant {variant!r} needs a named grasp: grasp=NAME")
    return Grasp()


def grasp(grasp: str | None = None, variant: str = NOMINAL, **options: Any) -> HandEnv:
    """`HPAC-Grasp-v0`; arguments of `grasp_task` and options of `HandEnv`."""
    return HandEnv(grasp_task(grasp, variant), **options)


def pick_place(**options: Any) -> HandEnv:
    """`HPAC-PickPlace-v0`; options are those of `HandEnv`."""
    return HandEnv(PickPlace(), **options)


def grasp_vector(num_envs: int = 1, grasp: str | None = None, variant: str = NOMINAL, **options: Any) -> VectorEnv:
    """`HPAC-Grasp-v0` as a vector environment; arguments of `grasp_task`, options of `HandVectorEnv`."""
    return _vector(GRASP, grasp_task(grasp, variant), num_envs, {"grasp": grasp, "variant": variant}, **options)


def pick_place_vector(num_envs: int = 1, **options: Any) -> VectorEnv:
    """`HPAC-PickPlace-v0` as a vector environment; options of `HandVectorEnv`."""
    return _vector(PICK_PLACE, PickPlace(), num_envs, {}, **options)


def posture_vector(num_envs: int = 1, **options: Any) -> VectorEnv:
    """`HPAC-Posture-v0` as a vector environment; options of `HandVectorEnv`."""
    return _vector(POSTURE, Posture(), num_envs, {}, **options)


def _vector(
    env_id: str,
    task: Task,
    num_envs: int,
    task_options: dict[str, Any],
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    **options: Any,
) -> VectorEnv:
    """n environments: one `HandVectorEnv` on MuJoCo; on PyBullet, which keeps Python's lock, Gymnasium's n processes.

    Args:
        env_id: the id of one of them.
        task: its task.
        num_envs: n.
        task_options: what the task was made of.
        autoreset_mode: as in Gymnasium's vector environments.
        options: those of `HandVectorEnv`.

    Raises:
        ParameterError: `num_envs` is below 1, or what `HandVectorEnv` refuses.
    """
    if (options.get("engine") or default_engine()) != "pybullet":
        return HandVectorEnv(task, num_envs, autoreset_mode, **options)
    if num_envs < 1:
        raise ParameterError(f"num_envs = {num_envs} must be at least 1")
    make = partial(gymnasium.make, f"hpac_gym:{env_id}", **task_options, **options)
    # A fork would copy locks that threads of other libraries hold at that moment, and its child would wait for them for ever.
    return AsyncVectorEnv([make] * num_envs, autoreset_mode=autoreset_mode, context="spawn")
