"""From a registered id to its task, its options and its environments.

This module has two entry points for each id of the table `hpac_gym.registration`, which Gymnasium asks
for by name: ``one My-v0`` and ``many My-v0``. Being text, they survive in the JSON of a spec."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import gymnasium
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, VectorEnv

from hpac_gym.envs.hand_env import GoalEnv, HandEnv
from hpac_gym.envs.options import COMMON, check_names
from hpac_gym.envs.vector_env import HandVectorEnv
from hpac_gym.envs.vector_infos import check_lengths
from hpac_gym.errors import ParameterError
from hpac_gym.registration import IDS, Registered, add_row, row_of
from hpac_gym.tasks.task import Option, Task, options_of

_UNLISTED = ("transmit", "physics", "max_episode_steps")
"""Arguments of the environments that no page lists: not options of an id."""


def make_task(env_id: str, /, **options: Any) -> Task:
    """Make the task of a registered id.

    Args:
        env_id: the id, as ``name-v0`` or ``module:name-v0``.
        options: the task's own options.

    Raises:
        EnvError: The id is not registered.
        TypeError: The task has no such option.
        ParameterError: The task refuses an option, or its episodes are too long for the id.
    """
    row = row_of(env_id)
    own = {name: value for name, value in row.defaults.items() if name in _own_options(row)}
    return _task(row, own | options)


def options_of_id(env_id: str) -> tuple[Option, ...]:
    """Every argument of an id, with its default there: those of its task, then those of every
    environment.
    """
    row = row_of(env_id)
    task = make_task(env_id)
    own = ", ".join(f"*{kind}*" for kind in task.sensed_terms)
    own = f"; {own}: with what this task alone senses" if own else ""
    common = [
        replace(option, values=task.observations, meaning=option.meaning + own)
        if option.name == "obs"
        else option
        for option in _common(task)
    ]
    return tuple(
        replace(option, default=row.defaults.get(option.name, option.default))
        for option in (*options_of(row.make), *common)
    )


def _common(task: Task) -> list[Option]:
    return [option for option in COMMON if option.name not in task.unused]


def _own_options(row: Registered) -> list[str]:
    return [option.name for option in options_of(row.make)]


def _task(row: Registered, options: dict[str, Any]) -> Task:
    task = row.make(**options)
    if not isinstance(task, Task):
        raise ParameterError(f"{row.id} needs a hpac_gym.tasks.task.Task, not {task!r}")
    needed = ("duration", "terms", "reward_terms")
    if missing := [name for name in needed if not hasattr(task, name)]:
        raise ParameterError(f"{row.id}: {type(task).__name__} has no {', '.join(missing)}")
    steps = task.control_steps
    limit = row.max_episode_steps
    if limit is None:
        return task
    if task.endless and steps != limit:
        raise ParameterError(
            f"config duration = {task.duration} s: give gymnasium.make(..., max_episode_steps=) instead"
        )
    if steps >= limit and not task.endless:
        kind = type(task).__name__
        told = f"lasts {steps} steps: {row.id} has at most {limit - 1}"
        if row.id not in IDS:
            raise ParameterError(f"an episode {told}; register it with more than {steps}")
        raise ParameterError(f"config timetable {told}; use hpac_gym.envs.HandEnv({kind}(config))")
    return task


def _given(row: Registered, options: dict[str, Any]) -> tuple[Task, dict[str, Any], dict[str, Any]]:
    """The task, its own options, and the other ones."""
    names = _own_options(row)
    if both := {option.name for option in COMMON}.intersection(names):
        raise ParameterError(
            f"{row.id}: its task's {min(both)!r} is an option of every environment"
        )
    own = {name: options.pop(name) for name in names if name in options}
    task = _task(row, own)
    known = [*names, *(option.name for option in _common(task))]
    check_names([name for name in options if name not in (*_UNLISTED, *task.unused)], known)
    return task, own, options


def _one(row: Registered, /, **options: Any) -> HandEnv:
    """One environment."""
    task, _, others = _given(row, options)
    return (GoalEnv if task.goal_terms else HandEnv)(task, **others)


def _many(
    row: Registered,
    /,
    num_envs: int = 1,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    **options: Any,
) -> VectorEnv:
    """n environments: one `HandVectorEnv` on MuJoCo, and n processes of Gymnasium on PyBullet, which
    holds the GIL.
    """
    task, own, others = _given(row, options)
    if others.get("max_episode_steps", ...) is None:  # as for one environment
        others["max_episode_steps"] = row.max_episode_steps
    if others.get("engine") != "pybullet":
        return HandVectorEnv(task, num_envs, autoreset_mode, **others)
    check_lengths(num_envs, others.get("max_episode_steps"))
    make = partial(_in_process, row, **own, **others)
    # A fork would copy locks held by threads of other libraries, and its child would wait for
    # them for ever.
    return AsyncVectorEnv([make] * num_envs, autoreset_mode=autoreset_mode, context="spawn")


def _in_process(row: Registered, /, **options: Any) -> gymnasium.Env:
    add_row(row)
    return gymnasium.make(row.id, **options)


_MAKERS = {"one": _one, "many": _many}


def __getattr__(name: str) -> Callable[..., Any]:
    """The entry point of a name, such as ``one HPAC-Grasp-v0``."""
    kind, _, env_id = name.partition(" ")
    if kind not in _MAKERS or not env_id:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    made = partial(_MAKERS[kind], row_of(env_id))
    made.metadata = HandEnv.metadata  # by which Gymnasium collects the pictures of "rgb_array_list"
    return made
