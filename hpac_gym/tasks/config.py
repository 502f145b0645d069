"""Frozen settings: their bounds, checked where they are made, and settings read from what JSON can hold."""

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
    return len(values) == count and all(isinstance(value, Real) and not isinstance(value, bool) for value in values)


def check_bounds(settings: Any, name: str) -> None:
    """Refuse a number or a range that leaves the `bounds` of its field, and make a tuple of a range.

    Args:
        settings: a frozen dataclass whose fields are made by `hpac_gym.tasks.task.setting`.
        name: what messages call it.

    Raises:
        ParameterError: A field is no number or no ordered pair of numbers, or leaves its bounds; None is let through where it
            is the default.
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
            raise ParameterError(f"{name} {quantity.name} = {given!r} must be {kind} within [{lowest:g}, {highest:g}]")
        object.__setattr__(settings, quantity.name, given if number else tuple(given))


def settings_from(default: Settings, given: Any, name: str) -> Settings:
    """Settings from themselves, or from a mapping of some of their fields, as JSON has them; the others keep their defaults.

    Args:
        default: the settings that None stands for, a frozen dataclass.
        given: settings of the same class; a mapping, nested where fields are settings themselves; or None.
        name: what messages call it.

    Raises:
        ParameterError: Something else, a field that there is not, or a value that is refused; the message names the field.
    """
    kind = type(default)
    if given is None or isinstance(given, kind):
        return default if given is None else given
    if not isinstance(given, Mapping):
        raise ParameterError(f"{name} {given!r} is neither a {kind.__name__} nor a mapping of its fields")
    values = dict(given)
    known = {quantity.name: quantity for quantity in fields(kind)}
    for field, value in given.items():
        if field not in known:
            raise ParameterError(f"{name} has no field {field!r}; it has {', '.join(known)}")
        if "bounds" not in known[field].metadata:  # which the settings check themselves
            values[field] = _value(getattr(default, field), value, f"{name} {field}")
    try:
        return replace(default, **values)
    except ParameterError:
        raise
    except ValueError as error:
        raise ParameterError(f"{name}: {error}") from None


def _value(default: Any, given: Any, name: str) -> Any:
    """A value of the default's kind: settings, a number, or as many numbers."""
    if is_dataclass(default):
        return settings_from(default, given, name)
    if isinstance(default, float):
        if not _are_numbers([given], 1) or not math.isfinite(given):
            raise ParameterError(f"{name} = {given!r} must be a finite number")
        return float(given)
    if not _are_numbers(given, len(default)):
        raise ParameterError(f"{name} = {given!r} must be {len(default)} numbers")
    return tuple(map(float, given))
