"""Hand files: reading and writing a `Hand` as TOML; errors name the file, the table and the
field.
"""

import json
import math
import tomllib
from collections.abc import Iterable, Iterator
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Any

from hpac_gym.errors import ParameterError
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.joints import DIGITS
from hpac_gym.model.parameters import Digit, Hand
from hpac_gym.output import read_text

SCHEMA = 1
"""Version of the hand file that this code reads."""

_SCALARS = (
    "d1",
    "d2",
    "servo_radius",
    "spring_stiffness",
    "tendon_stiffness",
    "drive_stiffness",
    "tension_limit",
)
_LISTS = ("joint_radius", "path_length")
_CMC = ("cmc_gain", "cmc_stiffness", "cmc_torque_limit")
_FRICTION = ("joint", "tendon")
_MOST = {
    "rate_limit": (100.0, "rad/s"),
    "length": (1.0, "m"),
    "servo angle": (math.pi, "rad"),
    "servo_zero": (math.pi, "rad"),
    "joint_friction": (1.0, "N m"),
}
"""Largest numbers of any hand (chosen): ten times a servo's speed, an arm's length, half a turn,
about a servo's torque.
"""
_TOP = ("schema", "name", "sources", "servo", "cmc", "digits", "workspace", "calibration")


def load_hand(path: str | PathLike[str] | None = None) -> Hand:
    """Hand described by a TOML file; without one `HPAC`.

    Raises:
        ParameterError: The file cannot be read, is not TOML, has another schema, or a number is
            missing, not a number, unknown or unphysical.
    """
    if path is None:
        return HPAC
    path = Path(path)
    return hand_from_toml(read_text(path, "hand file", ParameterError), str(path))


def hand_from_toml(text: str, origin: str) -> Hand:
    """Hand described by a TOML text; `origin` is its name in errors.

    Raises:
        ParameterError: As `load_hand`.
    """
    try:
        table = tomllib.loads(text)
    except ValueError as error:
        raise ParameterError(f"hand file {origin}: not TOML: {error}") from None
    try:
        return _hand_from_table(table)
    except ParameterError as error:
        raise ParameterError(f"hand file {origin}: {error}") from None


def hand_to_toml(hand: Hand) -> str:
    """Text of a hand file for a hand, which `hand_from_toml` reads back."""
    lines = [f"schema = {SCHEMA}", f"name = {_value(hand.name)}", "", "[sources]"]
    lines += [
        f"{key if key.isascii() and key.isidentifier() else _value(key)} = {_value(text)}"
        for key, text in hand.sources.items()
    ]
    lines += ["", "[servo]", f"rate_limit = {_value(hand.rate_limit)}", "", "[cmc]"]
    lines += [f"{key} = {_value(getattr(hand, key))}" for key in _CMC]
    for name, digit in hand.digits.items():
        lines += ["", f"[digits.{name}]", f"alpha_deg = {math.degrees(digit.alpha)!r}"]
        lines += [f"{key} = {_value(getattr(digit, key))}" for key in _SCALARS]
        lines += [f"{key} = {_value(getattr(digit, key))}" for key in _LISTS]
    lines += ["", "[workspace]"]
    lines += [f"{joint} = {_value(list(bounds))}" for joint, bounds in hand.workspace.items()]
    if hand.is_calibrated:
        lines += ["", "[calibration]", f"servo_zero = {_value(hand.calibration.servo_zero)}"]
        lines += [
            f"{part}_friction = {_value([getattr(item, part) for item in hand.calibration.friction])}"
            for part in _FRICTION
        ]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """A string, a number, also of NumPy, or a list of TOML: one of JSON, which may hold DEL as it is."""
    return json.dumps(value, ensure_ascii=False, default=float).replace("\x7f", "\\u007f")


def _hand_from_table(table: dict[str, Any]) -> Hand:
    if table.get("schema") != SCHEMA:
        raise ParameterError(f"schema {table.get('schema')!r} is not {SCHEMA}")
    _refuse_unknown(table, _TOP, "the file")
    digits = _table(table, "digits", DIGITS)
    servo = _table(table, "servo", ("rate_limit",))
    cmc = _table(table, "cmc", _CMC)
    sources = _table(table, "sources")
    for key, text in sources.items():
        if not isinstance(text, str):
            raise ParameterError(f"[sources] {key} must be text, not {text!r}")
    hand = Hand(
        name=str(table.get("name", "unnamed")),
        digits={name: _digit(name, _table(digits, name)) for name in DIGITS},
        workspace={name: _pair(value, name) for name, value in _table(table, "workspace").items()},
        rate_limit=_number(servo, "rate_limit"),
        **{name: _number(cmc, name) for name in _CMC},
        sources=sources,
        calibration=_calibration(table) if "calibration" in table else Calibration(),
    )
    for owner, name, value in _bounded(hand):
        most, unit = _MOST[name]
        if abs(value) > most:
            allowed = f"allowed at most {most:.6g} {unit}"
            raise ParameterError(f"{owner}{name} = {value:.6g} {unit}, {allowed}")
    return hand


def _bounded(hand: Hand) -> Iterator[tuple[str, str, float]]:
    """Owner, name in `_MOST` and value of every bounded number; the servo angles, which are computed
    from the lengths, last.
    """
    yield "", "rate_limit", hand.rate_limit
    for digit in hand.digits.values():
        lengths = (digit.d1, digit.d2, digit.servo_radius, *digit.joint_radius, *digit.path_length)
        yield from ((f"digit {digit.name}: ", "length", length) for length in lengths)
    for zero in hand.calibration.servo_zero:
        yield "[calibration] ", "servo_zero", zero
    for friction in hand.calibration.friction:
        yield "[calibration] ", "joint_friction", friction.joint
    for angle in (*hand.servo_min, *hand.servo_max):
        yield "", "servo angle", angle


def _calibration(table: dict[str, Any]) -> Calibration:
    columns = [f"{part}_friction" for part in _FRICTION]
    section = _table(table, "calibration", ("servo_zero", *columns))
    numbers = [_numbers(section, key) for key in columns]
    for key, values in zip(columns, numbers, strict=True):
        if len(values) != len(DIGITS):
            raise ParameterError(
                f"calibration: {key} must have {len(DIGITS)} entries, not {len(values)}"
            )
    return Calibration(_numbers(section, "servo_zero"), tuple(map(Friction, *numbers)))


def _digit(name: str, table: dict[str, Any]) -> Digit:
    _refuse_unknown(table, (*_SCALARS, *_LISTS, "alpha_deg"), f"digit {name}")
    try:
        numbers: dict[str, Any] = {key: _number(table, key) for key in _SCALARS}
        numbers |= {key: _numbers(table, key) for key in _LISTS}
        return Digit(name=name, alpha=math.radians(_number(table, "alpha_deg")), **numbers)
    except ParameterError as error:
        prefix = "" if str(error).startswith("digit") else f"digit {name}: "
        raise ParameterError(f"{prefix}{error}") from None


def _refuse_unknown(table: dict[str, Any], known: Iterable[str], owner: str) -> None:
    unknown = sorted(set(table) - set(known))
    if unknown:
        raise ParameterError(f"{owner} has unknown fields {', '.join(unknown)}")


def _table(table: dict[str, Any], key: str, known: Iterable[str] | None = None) -> dict[str, Any]:
    section = table.get(key)
    if not isinstance(section, dict):
        raise ParameterError(f"table [{key}] is missing")
    if known is not None:
        _refuse_unknown(section, known, f"[{key}]")
    return section


def _number(table: dict[str, Any], key: str) -> float:
    value = table.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ParameterError(f"{key} must be a number, not {value!r}")
    return float(str(value))  # infinite for an integer beyond every float


def _numbers(table: dict[str, Any], key: str) -> tuple[float, ...]:
    values = table.get(key)
    if not isinstance(values, list):
        raise ParameterError(f"{key} must be a list of numbers, not {values!r}")
    return tuple(_number({key: value}, key) for value in values)


def _pair(value: Any, name: str) -> tuple[float, float]:
    pair = _numbers({name: value}, name)
    if len(pair) != 2:
        raise ParameterError(f"workspace of {name} must be [min, max] in rad, not {value!r}")
    return pair


HPAC = hand_from_toml(
    (files("hpac_gym.model") / "data" / "hpac.toml").read_text(encoding="utf-8"), "hpac.toml"
)
"""The nominal H-PAC hand."""
