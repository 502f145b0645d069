"""Options: the arguments of an environment's id, as its page shows them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from inspect import Parameter, signature
from typing import Any, get_type_hints


@dataclass(frozen=True, slots=True)
class Option:
    """An argument of an id. A task states it beside the parameter of its constructor, as
    ``Annotated[type, Option(...)]``, where name and default are the parameter's.
    """

    meaning: str = ""
    values: tuple[Any, ...] = ()
    """Values that can be given by name."""
    others: str = ""
    """Other accepted values, in words."""
    name: str = ""
    default: Any = None


def options_of(make: Callable[..., Any]) -> tuple[Option, ...]:
    """Options of a task: the parameters of its class, or of the function that makes it."""
    hints = get_type_hints(make.__init__ if isinstance(make, type) else make, include_extras=True)
    found = []
    for name, parameter in signature(make).parameters.items():
        if parameter.kind in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD):
            continue
        told = getattr(hints.get(name), "__metadata__", ())
        option = next((entry for entry in told if isinstance(entry, Option)), Option())
        found.append(replace(option, name=name, default=parameter.default))
    return tuple(found)


def config_option(
    kind: type, holds: str = "sampling ranges, success criteria and reward weights"
) -> Option:
    """The option `config` of a task whose settings are of a class."""
    return Option(
        f"{holds}; None is as on this page",
        (None,),
        f"`hpac_gym.envs.{kind.__name__}`, dictionary of its fields",
    )
