"""Frozen settings: checks of their bounds on construction, settings from JSON-compatible mappings,
and checks of names.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache
from numbers import Real
from typing import Any, TypeVar

from hpac_gym.errors import ParameterError

Settings = TypeVar("Settings")


def are_numbers(given: object, count: int) -> bool:
    """Whether it is a list or tuple of as many numbers, 0 for any; a truth value is none."""
    if not isinstance(given, list | tuple) or count not in (0, len(given)):
        return False
    return all(
        type(value) in (float, int) or (isinstance(value, Real) and not isinstance(value, bool))
        for value in given
    )


def setting(default: Any = MISSING, meaning: str = "", **more: Any) -> Any:
    """A field of frozen settings.

    Args:
        default: its default: a number, a range, several values, or None; without one it has to be
            given.
        meaning: its meaning for the documentation.
        more: for `check_bounds`: `bounds`, lowest and highest value; `above` is True if the lowest
            one is refused; `unit`, unless the meaning has it in [ ]; `size`, number of values, 0 for
            any; `number` is True for a number without a default, or whose default is None. Anything
            else is up to the caller.
    """
    return field(default=default, metadata={"meaning": meaning, **more})


def check_bounds(settings: Any, name: str = "") -> None:
    """Refuse numbers and ranges that leave the `bounds` of their field, convert ranges to tuples,
    and mappings to the settings that their field has by default.

    Args:
        settings: a frozen dataclass whose fields are made by `setting`.
        name: name of the settings in error messages.

    Raises:
        ParameterError: A field is not a number, an ordered pair of numbers or as many as it has to
            be, or leaves its bounds; None is accepted where it is the default.
    """
    for row in _bounded(type(settings)):
        given = getattr(settings, row.name)
        if given is None and row.default is None:
            continue
        values = (given,) if row.count == 1 else given
        if not are_numbers(values, row.count) or not row.admits(values):
            fixed = row.ordered and are_numbers([given], 1) and row.admits([given, given])
            form = f", such as [{given!r}, {given!r}]" if fixed else ""
            raise ParameterError(f"{name} {row.name} = {given!r} {row.told}{form}".lstrip())
        if row.count != 1 and not isinstance(given, tuple):
            object.__setattr__(settings, row.name, tuple(given))
    for key, usual in _nested(type(settings)):
        value = settings_from(usual, getattr(settings, key), f"{name} {key}".lstrip())
        object.__setattr__(settings, key, value)


def check_choice(name: str, given: Any, known: Collection[Any]) -> None:
    """Refuse a value that is not one of the known names.

    Raises:
        ParameterError: It is not.
    """
    if not (isinstance(given, str | None) and given in known):
        raise ParameterError(f"{name} {given!r} is not one of {', '.join(map(str, known))}")


@dataclass(frozen=True, slots=True)
class _Bounded:
    """A field with bounds."""

    name: str
    default: Any
    low: float
    high: float
    count: int
    """Number of values, 0 for any."""
    ordered: bool
    told: str
    """What is allowed, in words."""

    def admits(self, values: Sequence[float]) -> bool:
        """Whether all are finite and within the bounds, and those of a range in order."""
        within = all(
            self.low <= value <= self.high and -math.inf < value < math.inf for value in values
        )
        return within and not (self.ordered and values[0] > values[1])


@cache
def _bounded(kind: type) -> tuple[_Bounded, ...]:
    rows = []
    for entry in fields(kind):
        told = entry.metadata
        if "bounds" not in told:
            continue
        low, high = told["bounds"]
        alone = "size" not in told and told.get("number", isinstance(entry.default, int | float))
        count = told.get("size", 1 if alone else 2)
        ordered = not alone and "size" not in told
        what = (
            "a number"
            if alone
            else "a range [lowest, highest]"
            if ordered
            else f"{count or ''} values".lstrip()
        )
        unit = told.get("unit") or told.get("meaning", "").partition("[")[2].partition("]")[0]
        begin = "]" if told.get("above") or low == -math.inf else "["
        lowest = math.nextafter(low, math.inf) if told.get("above") else low
        end = "[" if high == math.inf else "]"
        words = f"{unit} must be {what} within {begin}{low:g}, {high:g}{end} {unit}".strip()
        rows.append(_Bounded(entry.name, entry.default, lowest, high, count, ordered, words))
    return tuple(rows)


@cache
def _nested(kind: type) -> tuple[tuple[str, Any], ...]:
    """The fields that are settings themselves, each with its default."""
    made = {
        entry.name: entry.default_factory()
        for entry in fields(kind)
        if entry.default_factory is not MISSING
    }
    return tuple((name, usual) for name, usual in made.items() if is_dataclass(usual))


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
    if given is None:
        return default
    if isinstance(given, kind):
        for entry in fields(kind):
            if "bounds" not in entry.metadata:
                _value(
                    getattr(default, entry.name), getattr(given, entry.name), f"{name} {entry.name}"
                )
        return given
    if not isinstance(given, Mapping):
        raise ParameterError(
            f"{name} {given!r} is neither a {kind.__name__} nor a mapping of its fields"
        )
    values = dict(given)
    known = {quantity.name: quantity for quantity in fields(kind)}
    for key, value in given.items():
        if key not in known:
            raise ParameterError(f"{name} has no field {key!r}; it has {', '.join(known)}")
        # Fields with bounds are checked by the settings themselves.
        if "bounds" not in known[key].metadata:
            values[key] = _value(getattr(default, key), value, f"{name} {key}")
    try:
        return replace(default, **values)
    except ParameterError:
        raise
    except ValueError as error:
        raise ParameterError(f"{name}: {error}") from None


def _value(default: Any, given: Any, name: str) -> Any:
    """Convert a value to the type of its default: settings, or a number."""
    if is_dataclass(default):
        return settings_from(default, given, name)
    if not are_numbers([given], 1) or not math.isfinite(given):
        raise ParameterError(f"{name} = {given!r} must be a finite number")
    return float(given)
