"""Frozen settings: checks of their bounds on construction, and settings from JSON-compatible
mappings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from numbers import Real
from typing import Any, TypeVar

from hpac_gym.errors import ParameterError

Settings = TypeVar("Settings")


def _are_numbers(given: object, count: int) -> bool:
    values = given if isinstance(given, list | tuple) else ()
    return len(values) == count and all(
        isinstance(value, Real) and not isinstance(value, bool) for value in values
    )


def check_bounds(settings: Any, name: str) -> None:
    """Refuse numbers and ranges that leave the `bounds` of their field, and convert ranges to
    tuples.

    Args:
        settings: a frozen dataclass whose fields are made by `hpac_gym.tasks.task.setting`.
        name: name of the settings in error messages.

    Raises:
        ParameterError: A field is not a number or an ordered pair of numbers, or leaves its bounds;
            None is accepted where it is the default.
    """
    for quantity in fields(settings):
        given = getattr(settings, quantity.name)
        if "bounds" not in quantity.metadata or (given is None and quantity.default is None):
            continue
        lowest, highest = quantity.metadata["bounds"]
        number = isinstance(quantity.default, float)
        values = (given, given) if number else given
        if not _are_numbers(values, 2) or not lowest <= values[0] <= values[1] <= highest:
            kind = "a number" if number else "a range (lowest, highest)"
            raise ParameterError(
                f"{name} {quantity.name} = {given!r} must be {kind} within [{lowest:g}, {highest:g}]"
            )
        object.__setattr__(settings, quantity.name, given if number else tuple(given))


def settings_from(default: Settings, given: Any, name: str) -> Settings:
    """Settings from an instance, or from a mapping of some of their fields; the other fields keep
    their defaults.

    Args:
        default: default settings, a frozen dataclass; the result for None.
        given: settings of the same class; a mapping, nested where fields are settings themselves;
            or None.
        name: name of the settings in error messages.

    Raises:
        ParameterError: Wrong type, unknown field or refused value; the message names the field.
    """
    kind = type(default)
    if given is None or isinstance(given, kind):
        return default if given is None else given
    if not isinstance(given, Mapping):
        raise ParameterError(
            f"{name} {given!r} is neither a {kind.__name__} nor a mapping of its fields"
        )
    values = dict(given)
    known = {quantity.name: quantity for quantity in fields(kind)}
    for field, value in given.items():
        if field not in known:
            raise ParameterError(f"{name} has no field {field!r}; it has {', '.join(known)}")
        if (
            "bounds" not in known[field].metadata
        ):  # fields with bounds are checked by the settings themselves
            values[field] = _value(getattr(default, field), value, f"{name} {field}")
    try:
        return replace(default, **values)
    except ParameterError:
        raise
    except ValueError as error:
        raise ParameterError(f"{name}: {error}") from None


def _value(default: Any, given: Any, name: str) -> Any:
    """Convert a value to the type of its default: settings, a number, or a tuple of as many
    numbers.
    """
    if is_dataclass(default):
        return settings_from(default, given, name)
    if isinstance(default, float):
        if not _are_numbers([given], 1) or not math.isfinite(given):
            raise ParameterError(f"{name} = {given!r} must be a finite number")
        return float(given)
    if not _are_numbers(given, len(default)):
        raise ParameterError(f"{name} = {given!r} must be {len(default)} numbers")
    return tuple(map(float, given))
