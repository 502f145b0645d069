"""The table of registered tasks, a row an id: the package's own, and those that `register` adds.

A task is named as ``module:name`` and imported when its first environment is made, so that the table
costs nothing. Gymnasium is imported when ids are registered."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import resolve_name
from typing import Any

from hpac_gym.errors import EnvError, ParameterError


@dataclass(frozen=True, slots=True)
class Registered:
    """One row of the table.

    Raises:
        ParameterError: The task is not callable, or the number of steps not a positive whole number.
    """

    id: str
    task: str | Callable[..., Any]
    """Class of a `hpac_gym.tasks.task.Task`, or function that makes one; or where it is, as
    ``module:name``. Its parameters are options of the id.
    """
    max_episode_steps: int | None = None
    """Time limit; a task that ends its episodes itself has one step more, which never truncates."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """Options that the id has instead of the environment's or the task's own defaults."""

    def __post_init__(self) -> None:
        if not (callable(self.task) or (isinstance(self.task, str) and ":" in self.task)):
            raise ParameterError(
                f"task {self.task!r} must be a class or a function that makes a task, or 'module:name'"
            )
        steps = self.max_episode_steps
        if steps is not None and not (type(steps) is int and steps >= 1):
            raise ParameterError(f"max_episode_steps = {steps!r} must be a whole number from 1 on")

    @property
    def make(self) -> Callable[..., Any]:
        """The class or function that makes the task."""
        return resolve_name(self.task) if isinstance(self.task, str) else self.task


TASKS = (
    Registered("HPAC-Grasp-v0", "hpac_gym.tasks.grasp:Grasp", 65),
    Registered("HPAC-GraspAny-v1", "hpac_gym.tasks.grasp_any:GraspAny", 145),
    Registered("HPAC-GraspType-v0", "hpac_gym.tasks.grasp_types:GraspByType", 65),
    Registered("HPAC-Gentle-v0", "hpac_gym.tasks.gentle:Gentle", 89),
    Registered("HPAC-PickPlace-v0", "hpac_gym.tasks.pick_place:PickPlace", 111),
    Registered("HPAC-Posture-v1", "hpac_gym.tasks.posture:Posture", 40, {"randomize": "hand"}),
)
"""The tasks of this package."""
GRASP, GRASP_ANY, GRASP_TYPE, GENTLE, PICK_PLACE, POSTURE = IDS = tuple(row.id for row in TASKS)
_ROWS: dict[str, Registered] = {}


def register(
    env_id: str,
    task: str | Callable[..., Any],
    max_episode_steps: int | None = None,
    **defaults: Any,
) -> None:
    """Register a task under an id of one's own: `gymnasium.make`, `make_vec`, `HandVecEnv` and the
    commands then take it; commands as ``module:id``, where importing the module registers it.

    Args:
        env_id: the id, such as "My-v0".
        task: class of a `hpac_gym.tasks.task.Task` or function that makes one, or where it is, as
            ``module:name``; its parameters are options of the id.
        max_episode_steps: time limit of an episode; None leaves its end to the task.
        defaults: options of the id by default, such as `randomize="hand"`.

    Raises:
        ParameterError: The id is one of this package's or names a module, or the task or the number
            of steps cannot be used.
        gymnasium.error.Error: The id is not one of Gymnasium's form.
    """
    if env_id in IDS:
        raise ParameterError(f"{env_id!r} is an id of hpac_gym: choose another one")
    if ":" in env_id:
        raise ParameterError(f"id {env_id!r} must be without its module, such as 'My-v0'")
    _add(Registered(env_id, task, max_episode_steps, defaults))


def register_all() -> None:
    """Register the tasks of this package."""
    for row in TASKS:
        add_row(row)


def add_row(row: Registered) -> None:
    """Register a row, such as one of another process, unless its id is there."""
    if row.id not in _ROWS:
        _add(row)


def _add(row: Registered) -> None:
    import gymnasium

    gymnasium.register(
        id=row.id,
        entry_point=f"hpac_gym.envs.registered:one {row.id}",
        vector_entry_point=f"hpac_gym.envs.registered:many {row.id}",
        max_episode_steps=row.max_episode_steps,
        kwargs=dict(row.defaults),
    )
    _ROWS[row.id] = row


def full_id(env_id: str) -> str:
    """The id with the module that registers it: ``hpac_gym`` for one without."""
    return env_id if ":" in env_id else f"hpac_gym:{env_id}"


def row_of(env_id: str) -> Registered:
    """The row of an id, given as ``name-v0`` or ``module:name-v0``, whose module is imported.

    Raises:
        EnvError: It is not registered here.
    """
    module, _, name = env_id.rpartition(":")
    try:
        if module:
            import_module(module)
        return _ROWS[name]
    except ModuleNotFoundError as error:
        raise EnvError(f"no environment {env_id!r}: {error}") from None
    except KeyError:
        raise EnvError(
            f"no environment {env_id!r}: there are {', '.join(_ROWS)}; one of your own is registered "
            "by its module, as in 'module:My-v0'"
        ) from None
