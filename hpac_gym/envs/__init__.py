"""The environments. `import hpac_gym` registers them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from inspect import signature
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, VectorEnv

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.own_objects import own_object
from hpac_gym.envs.hand_env import HandEnv, PostureEnv, posture_task
from hpac_gym.envs.options import (
    GRASP,
    GRASP_ANY,
    GRASP_TYPE,
    PICK_PLACE,
    POSTURE,
    check_num_envs,
)
from hpac_gym.envs.randomization import Randomization
from hpac_gym.envs.vector_env import HandVectorEnv
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.simulation import default_engine
from hpac_gym.registration import register_all
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

register_all()

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
        grasp: name of one of the sixteen `GRASPS`; None draws a primitive in front of the open
            hand.
        variant: variant of a named grasp's object, such as "large" or "slippery"; see
            `tasks/data/grasps.toml`.
        object: object that replaces the primitive in every episode; a dictionary holds the
            arguments of `own_object`.
        config: sampling ranges, success criteria and reward weights, or a mapping of its fields;
            None is the default.

    Raises:
        GraspError: Unknown grasp or variant; or `variant` without a named grasp, or `object` with
            one.
        ParameterError: Invalid object or config; a config with ranges for a named grasp, with
            object ranges for `object`, or with too long an episode.
    """
    chosen = settings_from(GraspConfig(), config, "config")
    ranges = [
        field.name
        for field in fields(chosen)
        if "bounds" in field.metadata and field.name != "drop_distance"
    ]
    ranges = [name for name in ranges if getattr(chosen, name) != getattr(GraspConfig(), name)]
    if object is not None:
        if grasp is not None:
            raise GraspError(f"grasp {grasp!r} has its own object: give either grasp or object")
        try:
            object = own_object(**object) if isinstance(object, Mapping) else object
        except TypeError as error:
            raise ParameterError(f"object {object!r}: {error}") from None
        if not isinstance(object, ObjectSpec):
            raise ParameterError(
                f"object {object!r} is neither an ObjectSpec, as own_object gives one, nor a dictionary for it"
            )
        if other := [name for name in ranges if name in OBJECT_RANGES]:
            raise ParameterError(
                f"config {', '.join(other)}: an object of one's own has its own size, mass and friction"
            )
    if grasp is None and variant != NOMINAL:
        raise GraspError(f"variant {variant!r} needs a named grasp: grasp=NAME")
    if grasp is None:
        return _fitting(Grasp(chosen, object=object), GRASP)
    if ranges:
        raise ParameterError(
            f"config {', '.join(ranges)}: a named grasp such as {grasp!r} has its own object, place and hand"
        )
    return _fitting(GraspByName(grasp, variant, chosen), GRASP)


def _fitting(task: Task, env_id: str) -> Task:
    """Return the task, refusing one whose episodes reach the time limit of its id."""
    steps = round(task.duration * CONTROL_HZ)
    limit = gymnasium.spec(env_id).max_episode_steps
    if steps >= limit:
        kind = type(task).__name__
        raise ParameterError(
            f"config timetable lasts {steps} steps: {env_id} has at most {limit - 1}; use hpac_gym.envs.HandEnv({kind}(config))"
        )
    return task


def pick_place_task(config: PickPlaceConfig | Mapping | None = None) -> Task:
    """The task of `HPAC-PickPlace-v0`; `config` and errors as for `grasp_task`."""
    return _fitting(PickPlace(settings_from(PickPlaceConfig(), config, "config")), PICK_PLACE)


def grasp_any_task(
    objects: str = "train",
    wrist: str = "script",
    hands: str = "nominal",
    config: GraspAnyConfig | Mapping | None = None,
) -> Task:
    """The task of `HPAC-GraspAny-v1`; `config` and errors as for `grasp_task`, the others as for
    `GraspAny`.
    """
    return _fitting(
        GraspAny(objects, wrist, hands, settings_from(GraspAnyConfig(), config, "config")),
        GRASP_ANY,
    )


def grasp_type_task(
    types: str | Sequence[str] = "all",
    objects: str = "train",
    wrist: str = "free",
    config: GraspTypeConfig | Mapping | None = None,
) -> Task:
    """The task of `HPAC-GraspType-v0`; the first three as for `GraspByType`, `config` and errors as
    for `grasp_task`.
    """
    return _fitting(
        GraspByType(types, objects, wrist, settings_from(GraspTypeConfig(), config, "config")),
        GRASP_TYPE,
    )


def _entry_points(
    env_id: str, make_task: Callable[..., Task]
) -> tuple[Callable[..., HandEnv], Callable[..., VectorEnv]]:
    """Entry points of an id, for one environment and for n; they take the task's arguments and the
    options of `HandEnv`.

    n environments are one `HandVectorEnv` on MuJoCo, and n processes of Gymnasium on PyBullet,
    which holds the GIL."""

    def given(options: dict[str, Any]) -> tuple[Task, dict[str, Any], dict[str, Any]]:
        """The task, its arguments, and the other options."""
        if options.get("hands", "nominal") != "nominal" and options.get("hand", HPAC) is not HPAC:
            raise ParameterError(
                f"hands {options['hands']!r} and a hand of one's own were given: give either"
            )
        of_task = {
            name: options.pop(name) for name in signature(make_task).parameters if name in options
        }
        return make_task(**of_task), of_task, options

    def one(**options: Any) -> HandEnv:
        task, _, others = given(options)
        return HandEnv(task, **others)

    def many(
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **options: Any,
    ) -> VectorEnv:
        task, of_task, others = given(options)
        if (others.get("engine") or default_engine()) != "pybullet":
            return HandVectorEnv(task, num_envs, autoreset_mode, **others)
        check_num_envs(num_envs)
        make = partial(gymnasium.make, f"hpac_gym:{env_id}", **of_task, **others)
        # A fork would copy locks held by threads of other libraries, and its child would wait for
        # them for ever.
        return AsyncVectorEnv([make] * num_envs, autoreset_mode=autoreset_mode, context="spawn")

    return one, many


grasp, grasp_vector = _entry_points(GRASP, grasp_task)
grasp_any, grasp_any_vector = _entry_points(GRASP_ANY, grasp_any_task)
grasp_type, grasp_type_vector = _entry_points(GRASP_TYPE, grasp_type_task)
pick_place, pick_place_vector = _entry_points(PICK_PLACE, pick_place_task)
_, posture_vector = _entry_points(POSTURE, posture_task)
