"""The environments. `import hpac_gym` registers them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, VectorEnv

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.own_objects import own_object
from hpac_gym.envs.hand_env import HandEnv, PostureEnv, posture_task
from hpac_gym.envs.options import GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE, POSTURE_V0
from hpac_gym.envs.randomization import Randomization
from hpac_gym.envs.vector_env import HandVectorEnv
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.simulation import default_engine
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.config import settings_from
from hpac_gym.tasks.grasp import OBJECT_RANGES, Grasp, GraspByName, GraspConfig
from hpac_gym.tasks.grasp_any import GraspAny, GraspAnyConfig
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL, GraspError
from hpac_gym.tasks.grasp_types import GraspByType, GraspTypeConfig
from hpac_gym.tasks.pick_place import PickPlace, PickPlaceConfig
from hpac_gym.tasks.posture import Posture, PostureConfig
from hpac_gym.tasks.scripted import ScriptedClosure, ScriptedPickPlace, scripted_closure
from hpac_gym.tasks.task import CONTROL_HZ, Task

__all__ = [
    "GRASPS",
    "CameraNoise",
    "Grasp",
    "GraspAny",
    "GraspAnyConfig",
    "GraspByName",
    "GraspByType",
    "GraspConfig",
    "GraspError",
    "GraspTypeConfig",
    "HandEnv",
    "HandVectorEnv",
    "ObjectSpec",
    "PickPlace",
    "PickPlaceConfig",
    "Posture",
    "PostureConfig",
    "PostureEnv",
    "Randomization",
    "SceneSetup",
    "ScriptedClosure",
    "ScriptedPickPlace",
    "scripted_closure",
]


def grasp_task(
    grasp: str | None = None,
    variant: str = NOMINAL,
    object: ObjectSpec | Mapping[str, Any] | None = None,
    config: GraspConfig | Mapping[str, Any] | None = None,
) -> Task:
    """The task of `HPAC-Grasp-v0`.

    Args:
        grasp: one of the sixteen of `GRASPS` by its name; None draws a primitive of any size in front of the open hand.
        variant: of a named grasp's object, such as "large" or "slippery"; see `tasks/data/grasps.toml`.
        object: takes the primitive's place in every episode; a dictionary has the arguments of `own_object`.
        config: what episodes are drawn from and judged by, or a mapping of its fields; None is the default.

    Raises:
        GraspError: No grasp or variant has that name, a variant of no named grasp is asked for, or another object for one.
        ParameterError: No such object; or a config that is none, with ranges for a named grasp, with ranges of the object for an
            object of one's own, or with too long an episode.
    """
    chosen = settings_from(GraspConfig(), config, "config")
    ranges = [field.name for field in fields(chosen) if "bounds" in field.metadata and field.name != "drop_distance"]
    ranges = [name for name in ranges if getattr(chosen, name) != getattr(GraspConfig(), name)]
    if object is not None:
        if grasp is not None:
            raise GraspError(f"grasp {grasp!r} has its own object: give either grasp or object")
        try:
            object = own_object(**object) if isinstance(object, Mapping) else object
        except TypeError as error:
            raise ParameterError(f"object {object!r}: {error}") from None
        if not isinstance(object, ObjectSpec):
            raise ParameterError(f"object {object!r} is neither an ObjectSpec, as own_object gives one, nor a dictionary for it")
        if other := [name for name in ranges if name in OBJECT_RANGES]:
            raise ParameterError(f"config {', '.join(other)}: an object of one's own has its own size, mass and friction")
    if grasp is None and variant != NOMINAL:
        raise GraspError(f"variant {variant!r} needs a named grasp: grasp=NAME")
    if grasp is None:
        return _fitting(Grasp(chosen, object=object), GRASP)
    if ranges:
        raise ParameterError(f"config {', '.join(ranges)}: a named grasp such as {grasp!r} has its own object, place and hand")
    return _fitting(GraspByName(grasp, variant, chosen), GRASP)


def _fitting(task: Task, env_id: str) -> Task:
    """The task, if its episodes end before the time limit of an id cuts them."""
    steps, limit = round(task.duration * CONTROL_HZ), gymnasium.spec(env_id).max_episode_steps
    if steps >= limit:
        kind = type(task).__name__
        raise ParameterError(
            f"config timetable lasts {steps} steps: {env_id} has at most {limit - 1}; use hpac_gym.envs.HandEnv({kind}(config))"
        )
    return task


def pick_place_task(config: PickPlaceConfig | Mapping | None = None) -> Task:
    """The task of `HPAC-PickPlace-v0`; `config` and errors as for `grasp_task`."""
    return _fitting(PickPlace(settings_from(PickPlaceConfig(), config, "config")), PICK_PLACE)


def grasp(grasp: str | None = None, variant: str = NOMINAL, object: Any = None, config: Any = None, **options: Any) -> HandEnv:
    """`HPAC-Grasp-v0`; arguments of `grasp_task` and options of `HandEnv`."""
    return HandEnv(grasp_task(grasp, variant, object, config), **options)


def grasp_any_task(
    objects: str = "train", wrist: str = "script", hands: str = "nominal", config: GraspAnyConfig | Mapping | None = None
) -> Task:
    """The task of `HPAC-GraspAny-v0`; the first three as for `GraspAny`, `config` and errors as for `grasp_task`."""
    return _fitting(GraspAny(objects, wrist, hands, settings_from(GraspAnyConfig(), config, "config")), GRASP_ANY)


def _only(hands: str, options: Mapping[str, Any]) -> str:
    """The set of hands, unless a hand is given too.

    Raises:
        ParameterError: It is.
    """
    if hands != "nominal" and options.get("hand", HPAC) is not HPAC:
        raise ParameterError(f"hands {hands!r} and a hand of one's own were given: give either")
    return hands


def grasp_any(
    objects: str = "train", wrist: str = "script", hands: str = "nominal", config: Any = None, **options: Any
) -> HandEnv:
    """`HPAC-GraspAny-v0`; arguments of `grasp_any_task` and options of `HandEnv`."""
    return HandEnv(grasp_any_task(objects, wrist, _only(hands, options), config), **options)


def grasp_type_task(
    types: str | Sequence[str] = "all", objects: str = "train", wrist: str = "free",
    config: GraspTypeConfig | Mapping | None = None,
) -> Task:  # fmt: skip
    """The task of `HPAC-GraspType-v0`; the first three as for `GraspByType`, `config` and errors as for `grasp_task`."""
    return _fitting(GraspByType(types, objects, wrist, settings_from(GraspTypeConfig(), config, "config")), GRASP_TYPE)


def grasp_type(
    types: str | Sequence[str] = "all", objects: str = "train", wrist: str = "free", config: Any = None, **options: Any
) -> HandEnv:
    """`HPAC-GraspType-v0`; arguments of `grasp_type_task` and options of `HandEnv`."""
    return HandEnv(grasp_type_task(types, objects, wrist, config), **options)


def pick_place(config: Any = None, **options: Any) -> HandEnv:
    """`HPAC-PickPlace-v0`; the argument of `pick_place_task` and options of `HandEnv`."""
    return HandEnv(pick_place_task(config), **options)


def grasp_vector(
    num_envs: int = 1, grasp: str | None = None, variant: str = NOMINAL, object: Any = None, config: Any = None, **options: Any
) -> VectorEnv:
    """`HPAC-Grasp-v0` as a vector environment; arguments of `grasp_task`, options of `HandVectorEnv`."""
    task_options = {"grasp": grasp, "variant": variant, "object": object, "config": config}
    return _vector(GRASP, grasp_task(**task_options), num_envs, task_options, **options)


def grasp_any_vector(
    num_envs: int = 1, objects: str = "train", wrist: str = "script", hands: str = "nominal", config: Any = None, **options: Any
) -> VectorEnv:
    """`HPAC-GraspAny-v0` as a vector environment; arguments of `grasp_any_task`, options of `HandVectorEnv`."""
    task_options = {"objects": objects, "wrist": wrist, "hands": _only(hands, options), "config": config}
    return _vector(GRASP_ANY, grasp_any_task(**task_options), num_envs, task_options, **options)


def grasp_type_vector(
    num_envs: int = 1, types: str | Sequence[str] = "all", objects: str = "train", wrist: str = "free", config: Any = None,
    **options: Any,
) -> VectorEnv:  # fmt: skip
    """`HPAC-GraspType-v0` as a vector environment; arguments of `grasp_type_task`, options of `HandVectorEnv`."""
    task_options = {"types": types, "objects": objects, "wrist": wrist, "config": config}
    return _vector(GRASP_TYPE, grasp_type_task(**task_options), num_envs, task_options, **options)


def pick_place_vector(num_envs: int = 1, config: Any = None, **options: Any) -> VectorEnv:
    """`HPAC-PickPlace-v0` as a vector environment; the argument of `pick_place_task`, options of `HandVectorEnv`."""
    return _vector(PICK_PLACE, pick_place_task(config), num_envs, {"config": config}, **options)


def posture_vector(num_envs: int = 1, config: Any = None, reachable: bool = False, **options: Any) -> VectorEnv:
    """`HPAC-Posture-v0` or v1 as a vector environment; arguments of `posture_task`, options of `HandVectorEnv`."""
    task_options = {"config": config, "reachable": reachable}
    return _vector(POSTURE if reachable else POSTURE_V0, posture_task(**task_options), num_envs, task_options, **options)


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
