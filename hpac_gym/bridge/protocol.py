"""The protocol: its description as Python values, read from `protocol.toml` in this folder, and the codec
between frames and bytes. Pure data, pure functions and one splitter; no I/O, no clock, no thread.

On the wire a frame is COBS between zero bytes: header, payload of a fixed length, CRC-32 over both.
`tools.wire_files` writes the C header from the same description."""

import re
import struct
import tomllib
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cache
from importlib.resources import files
from itertools import islice

from hpac_gym.bridge.codes import (
    Action as Action,
    Fault as Fault,
    Reason as Reason,
    Reset as Reset,
    State as State,
)
from hpac_gym.bridge.errors import FrameError, VersionError

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
    return sum(part.size * part.count for part in fields)


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


_HEADER = struct.Struct("<" + "".join(part.struct_format for part in HEADER))
_COBS_MAX = FRAME_MAX + 1
Fields = Mapping[str, int | tuple[int, ...]]
"""Integers by field; a tuple for a field of several."""
_TAIL_MAX = 4096


@dataclass(frozen=True, slots=True)
class Frame:
    """Contents of one frame: raw integers, in the units of docs/wire.md."""

    name: str
    seq: int = 0
    flags: int = 0
    fields: Fields = field(default_factory=dict)

    def numbers(self, name: str) -> tuple[int, ...]:
        """The integers of a field."""
        value = self.fields[name]
        return tuple(value) if isinstance(value, tuple | list) else (value,)

    def number(self, name: str) -> int:
        """The integer of a field of one."""
        return self.numbers(name)[0]


@cache
def _payload(message: Message) -> struct.Struct:
    return struct.Struct("<" + "".join(part.struct_format for part in message.fields))


def encode(frame: Frame, version: int = VERSION) -> bytes:
    """Encode a frame for the wire, with a zero before and after.

    Raises:
        KeyError: The message is unknown, or a field is missing.
        FrameError: A value does not fit its field.
    """
    message = MESSAGES[frame.name]
    values = [number for part in message.fields for number in frame.numbers(part.name)]
    try:
        header = _HEADER.pack(version, message.code, frame.seq, frame.flags)
        body = header + _payload(message).pack(*values)
    except struct.error as error:
        raise FrameError(
            f"{frame.name} {dict(frame.fields)}, sequence {frame.seq}: {error}"
        ) from None
    return b"\0" + cobs_encode(body + zlib.crc32(body).to_bytes(CRC_LENGTH, "little")) + b"\0"


def decode(encoded: bytes) -> Frame:
    """Decode the bytes between two zero bytes.

    Raises:
        FrameError: Not COBS, too short or too long, damaged, or of another version, an unknown type
            or a wrong length.
    """
    data = cobs_decode(encoded)
    if not HEADER_LENGTH + CRC_LENGTH <= len(data) <= FRAME_MAX:
        raise FrameError(
            f"a frame of {len(data)} bytes; they have {HEADER_LENGTH + CRC_LENGTH} to {FRAME_MAX}"
        )
    body = data[:-CRC_LENGTH]
    crc = int.from_bytes(data[-CRC_LENGTH:], "little")
    if zlib.crc32(body) != crc:
        raise FrameError(f"damaged: CRC is {crc:08x}, must be {zlib.crc32(body):08x}")
    version, code, seq, flags = _HEADER.unpack_from(body)
    if version != VERSION:
        raise VersionError(version)
    message = MESSAGE_BY_CODE.get(code)
    if message is None:
        raise FrameError(f"unknown message type 0x{code:02x}")
    if len(body) != HEADER_LENGTH + message.length:
        raise FrameError(
            f"{message.name} with {len(body) - HEADER_LENGTH} bytes of payload, must be {message.length}"
        )
    values = iter(_payload(message).unpack_from(body, HEADER_LENGTH))
    fields = {
        part.name: tuple(islice(values, part.count)) if part.count > 1 else next(values)
        for part in message.fields
    }
    return Frame(message.name, seq, flags, fields)


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing: `data`, shorter than 254 bytes as every frame is, without
    a zero byte.
    """
    return b"".join(bytes([len(run) + 1]) + run for run in data.split(b"\0"))


def cobs_decode(encoded: bytes) -> bytes:
    """The inverse of `cobs_encode`.

    Raises:
        FrameError: The data contains a zero byte, or a run exceeds its end.
    """
    runs = []
    at = 0
    while at < len(encoded):
        code = encoded[at]
        run = encoded[at + 1 : at + code]
        if code == 0 or len(run) != code - 1 or 0 in run:
            raise FrameError(f"not COBS at byte {at} of {encoded.hex()}")
        runs.append(run)
        at += code
    return b"\0".join(runs)


class FrameSplitter:
    """Splits a byte stream at its zeros; pieces that are not valid frames are dropped.

    Attributes:
        tail: the last 4,096 bytes received.
        other_version: protocol version of the last intact frame of another version, or None.
    """

    def __init__(self) -> None:
        self.tail = b""
        self.other_version: int | None = None
        self._pending = b""

    def push(self, data: bytes) -> list[tuple[bytes, Frame]]:
        """Process received bytes; returns each complete frame, preceded by its encoded bytes."""
        frames = []
        self.tail = (self.tail + data)[-_TAIL_MAX:]
        *pieces, rest = (self._pending + data).split(b"\0")
        # One byte more than a frame has: a flood without zeros is no frame, and fills no memory.
        self._pending = rest[: _COBS_MAX + 1]
        for encoded in filter(None, pieces):
            try:
                frames.append((encoded, decode(encoded)))
            except VersionError as error:
                self.other_version = error.version
            except FrameError:
                continue
        return frames
