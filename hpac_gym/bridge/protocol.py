"""The protocol description as Python values, read from `protocol.toml` in this folder.

Pure data: names, codes and layouts. `frame` encodes them as bytes, `tools.wire_files` writes the C
header."""

import re
import tomllib
from dataclasses import dataclass
from enum import IntEnum
from importlib.resources import files

from hpac_gym.bridge.codes import (
    Action as Action,
    Fault as Fault,
    Reason as Reason,
    Reset as Reset,
    State as State,
)

_TYPE = re.compile(r"^([ui])(8|16|32)(?:\[(\d+)\])?$")


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a frame: `count` little-endian integers of `size` bytes each, starting at byte
    `offset`.
    """

    name: str
    signed: bool
    size: int
    count: int
    offset: int

    @property
    def struct_format(self) -> str:
        """Format of this field for the `struct` module."""
        letter = {1: "b", 2: "h", 4: "i"}[self.size]
        return f"{self.count}{letter if self.signed else letter.upper()}"


@dataclass(frozen=True, slots=True)
class Message:
    """One message type: its code and the fixed layout of its payload."""

    name: str
    code: int
    from_host: bool
    meaning: str
    fields: tuple[Field, ...]

    @property
    def length(self) -> int:
        """Length of the payload [bytes]."""
        return _length(self.fields)


def _length(fields: tuple[Field, ...]) -> int:
    return sum(field.size * field.count for field in fields)


def _read_fields(pairs: list[list[str]]) -> tuple[Field, ...]:
    fields: list[Field] = []
    for name, type_name in pairs:
        sign, bits, count = _TYPE.findall(type_name)[0]
        offset = _length(tuple(fields))
        fields.append(Field(name, sign == "i", int(bits) // 8, int(count or 1), offset))
    return tuple(fields)


SOURCE = files(__package__).joinpath("protocol.toml").read_text(encoding="utf-8")
DESCRIPTION = tomllib.loads(SOURCE)
"""The contents of the file."""

VERSION: int = DESCRIPTION["version"]
HEADER = _read_fields(DESCRIPTION["frame"]["header"])
HEADER_LENGTH = _length(HEADER)
CRC_LENGTH = 4

FLAG_MINIMUM_JERK: int = DESCRIPTION["flags"]["minimum_jerk"]

CONSTANTS: dict[str, int] = DESCRIPTION["constants"]
PULSE: dict[str, int] = DESCRIPTION["pulse"]
LOAD: dict[str, int] = DESCRIPTION["load"]


MESSAGES = {
    entry["name"]: Message(
        entry["name"],
        entry["code"],
        entry["from"] == "host",
        entry["meaning"],
        _read_fields(entry["fields"]),
    )
    for entry in DESCRIPTION["message"]
}
"""All messages by name."""

MESSAGE_BY_CODE = {message.code: message for message in MESSAGES.values()}

FRAME_MAX = HEADER_LENGTH + max(message.length for message in MESSAGES.values()) + CRC_LENGTH
"""Longest frame before COBS, in either direction [bytes]."""

ANGLE_UNIT = CONSTANTS["angle_unit_urad"] / 1e6
"""One step of an angle on the wire [rad]."""


def name_of(enum: type[IntEnum], value: int) -> str:
    """Name of an enum value, such as `unknown_7` for a value that this version does not know."""
    try:
        return enum(value).name
    except ValueError:
        return f"unknown_{value}"
