"""Hand files: reading and writing a `Hand` as TOML; errors name the file, the table and the
field.
"""

import json
import math
import tomllib
from collections.abc import Iterable
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Any

from hpac_gym.errors import ParameterError
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.joints import DIGITS
from hpac_gym.model.parameters import Digit, Hand
from hpac_gym.output import read_text
from hpac_gym.settings import are_numbers

SCHEMA = 1
"""Version of the hand file that this code reads."""

_CMC = ("cmc_gain", "cmc_stiffness", "cmc_torque_limit")
_DIGIT = (
    *("d1", "d2", "servo_radius", "spring_stiffness", "tendon_stiffness", "drive_stiffness"),
    *("tension_limit", "joint_radius", "path_length"),
)
_TOP = ("schema", "name", "sources", "servo", "cmc", "digits", "workspace")
_LONGEST = 1.0
"""Largest length in any hand (chosen): an arm's [m]."""
_FURTHEST = math.pi
"""Largest servo angle of any hand (chosen): half a turn [rad]."""


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
    except (TypeError, ValueError) as error:
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
        lines += [f"{key} = {_value(getattr(digit, key))}" for key in _DIGIT]
    lines += ["", "[workspace]"]
    lines += [f"{joint} = {_value(list(bounds))}" for joint, bounds in hand.workspace.items()]
    if hand.is_calibrated:
        friction = hand.calibration.friction
        lines += ["", "[calibration]", f"servo_zero = {_value(hand.calibration.servo_zero)}"]
        lines += [f"joint_friction = {_value([item.joint for item in friction])}"]
        lines += [f"tendon_friction = {_value([item.tendon for item in friction])}"]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """A string, a number, also of NumPy, or a list of TOML: one of JSON, which may hold DEL as it is."""
    return json.dumps(value, ensure_ascii=False, default=float).replace("\x7f", "\\u007f")


def _floats(value: Any) -> Any:
    """A value of TOML whose integers are floats, infinite beyond every float."""
    if isinstance(value, dict):
        return {key: _floats(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_floats(entry) for entry in value]
    return float(str(value)) if type(value) is int else value


def _hand_from_table(table: dict[str, Any]) -> Hand:
    if table.get("schema") != SCHEMA:
        raise ParameterError(f"schema {table.get('schema')!r} is not {SCHEMA}")
    table = _floats({"name": "unnamed", "calibration": None} | table)
    _table(table, (*_TOP, "calibration"), "the file")
    for name in ("digits", "workspace", "sources"):
        if not isinstance(table[name], dict):
            raise ParameterError(f"{name} = {table[name]!r} must be a table")
    for key, text in table["sources"].items():
        if not isinstance(text, str):
            raise ParameterError(f"[sources] {key} must be text, not {text!r}")
    hand = Hand(
        name=str(table["name"]),
        digits={name: _digit(name, given) for name, given in table["digits"].items()},
        workspace=table["workspace"],
        **_table(table["servo"], ("rate_limit",), "[servo]"),
        **_table(table["cmc"], _CMC, "[cmc]"),
        sources=table["sources"],
        calibration=_calibration(table["calibration"]),
    )
    for digit in hand.digits.values():
        lengths = (digit.d1, digit.d2, digit.servo_radius, *digit.joint_radius, *digit.path_length)
        if max(lengths) > _LONGEST:
            raise ParameterError(
                f"digit {digit.name}: length = {max(lengths):.6g} m, allowed at most {_LONGEST:g} m"
            )
    furthest = max(map(abs, (*hand.servo_min, *hand.servo_max)))
    if furthest > _FURTHEST:
        raise ParameterError(
            f"servo angle = {furthest:.6g} rad, allowed at most {_FURTHEST:.6g} rad"
        )
    return hand


def _digit(name: str, given: Any) -> Digit:
    table = dict(_table(given, (*_DIGIT, "alpha_deg"), f"digit {name}"))
    degrees = table.pop("alpha_deg")
    if not are_numbers([degrees], 1):
        raise ParameterError(f"digit {name} alpha_deg = {degrees!r} must be a number")
    return Digit(name=name, alpha=math.radians(degrees), **table)


def _calibration(given: Any) -> Calibration:
    if given is None:
        return Calibration()
    columns = ("joint_friction", "tendon_friction")
    table = _table(given, ("servo_zero", *columns), "[calibration]")
    for key in columns:
        if not are_numbers(table[key], len(DIGITS)):
            raise ParameterError(
                f"[calibration] {key} = {table[key]!r} must be {len(DIGITS)} numbers"
            )
    return Calibration(
        table["servo_zero"], tuple(map(Friction, table["joint_friction"], table["tendon_friction"]))
    )


def _table(given: Any, known: Iterable[str], owner: str) -> dict[str, Any]:
    """The table itself, which has exactly the fields that are known."""
    table = given if isinstance(given, dict) else {}
    if wrong := sorted(set(table) ^ set(known)):
        raise ParameterError(f"{owner} is missing or does not know {', '.join(wrong)}")
    return table


HPAC = hand_from_toml(
    (files("hpac_gym.model") / "data" / "hpac.toml").read_text(encoding="utf-8"), "hpac.toml"
)
"""The nominal H-PAC hand."""
