"""A second codec, written from docs/wire.md alone: what judges a device must not share the link's mistakes.
It imports nothing from the link, its codec or the firmware core.
"""

import struct
import zlib
from collections import namedtuple

VERSION = 2
HELLO, ARM, MOVE, HEARTBEAT, ESTOP, CLEAR, STATUS = range(1, 8)
DEVICE_HELLO, ACK, DEVICE_STATUS, FAULT = range(0x81, 0x85)
LENGTHS = {HELLO: 4, ARM: 11, MOVE: 18, HEARTBEAT: 4, ESTOP: 0, CLEAR: 4, STATUS: 2}
"""Payload length of each host message [bytes]."""
MINIMUM_JERK = 1
NO_ACK = 2
HOLD, RELAX, DETACH = range(3)
FAULT_ESTOP = 1
FAULT_WATCHDOG = 2
FAULT_OVERLOAD = 3


def frame(
    kind: int, seq: int, payload: bytes = b"", flags: int = 0, version: int = VERSION
) -> bytes:
    """Encode a frame for the wire."""
    return seal(struct.pack("<BBHB", version, kind, seq, flags) + payload)


def seal(body: bytes) -> bytes:
    """Header and payload with CRC-32 and COBS, between zeros."""
    runs = (body + struct.pack("<I", zlib.crc32(body))).split(b"\0")
    return b"\0" + b"".join(bytes([len(run) + 1]) + run for run in runs) + b"\0"


def unseal(piece: bytes) -> tuple[bytes, bool] | None:
    """Header and payload of a piece between two zeros, and whether its CRC is right; None if it is
    not COBS or too short.
    """
    runs = []
    while piece:
        if piece[0] > len(piece):
            return None
        runs.append(piece[1 : piece[0]])
        piece = piece[piece[0] :]
    data = b"\0".join(runs)
    if len(data) < 9:
        return None
    return data[:-4], zlib.crc32(data[:-4]) == struct.unpack("<I", data[-4:])[0]


Message = namedtuple("Message", "version kind seq flags payload")
"""An intact frame: integers, and the bytes of its payload."""


class Reader:
    """Splits a byte stream into intact frames."""

    def __init__(self) -> None:
        self._rest = b""

    def push(self, data: bytes) -> list[Message]:
        """Process bytes and return the intact frames that they complete."""
        *pieces, self._rest = (self._rest + data).split(b"\0")
        self._rest = self._rest[-300:]
        messages = []
        for body, intact in filter(None, (unseal(piece) for piece in pieces if piece)):
            version, kind, seq, flags = struct.unpack("<BBHB", body[:5])
            messages += [Message(version, kind, seq, flags, body[5:])] if intact else []
        return messages
