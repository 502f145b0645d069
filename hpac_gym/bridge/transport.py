"""The byte transport of a serial port, pseudo-terminal or TCP socket. The in-process one is in
`hands`.

A transport also owns the clock, so that a link to a virtual hand runs in virtual time without
sleeping."""

import os
import re
import socket
import struct
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Protocol

import serial

from hpac_gym.bridge.errors import PortError
from hpac_gym.bridge.protocol import CONSTANTS

READ_SIZE = 4096
"""Bytes that end a read though more may wait."""
_WRITE_TIMEOUT = 1.0
"""A port that accepts no bytes for this long is considered gone [s]."""
_MISSED_MAX = 50
_MISSED_WAIT = 1e-3
"""Reads in a row that may find no bytes though there were some, and the time between them [s]."""
_ADVICE = {
    "exclusively lock": "{port} is used by another program; close it (`fuser {port}` names it)",
    "ermission": "{port}: permission denied; add yourself to the group of the port (Debian: dialout) and log in again",
    "No such file|FileNotFoundError": "{port}: no such port; `hpac doctor` lists the ones that are there",
    "Inappropriate ioctl|Is a directory": "{port} is not a serial port; `hpac doctor` lists the ones that are there",
}
"""What to do about an error of a port that does not open; on Windows its text tells the kind of the
system's.
"""


class Transport(Protocol):
    """The methods that a `HandLink` needs. Each raises `PortError` once the other end is gone."""

    def read(self, timeout: float) -> bytes:
        """Return bytes as soon as there are any, or none after `timeout` [s]."""

    def write(self, data: bytes) -> None:
        """Send all of `data`, or raise."""

    def now(self) -> float:
        """Monotonic time [s]."""
        return time.monotonic()

    def close(self) -> None:
        """Release the port. May be called repeatedly."""
        return


class SerialTransport(Transport):
    """A serial port or pseudo-terminal through pyserial, locked against other programs.

    `lock=False` opens it beside the program that has the lock: for a stop, which a hand accepts
    from anybody. Each of the two then reads only some of the hand's bytes.

    DTR and RTS are set low as soon as the port is open, both at once: many boards reset while one
    of them alone is low, and forget heat and fault. A board may reset all the same.

    Args:
        port: `/dev/ttyUSB0`, `COM3`, the path of a pseudo-terminal, `socket://HOST:PORT`, or any
            URL that pyserial takes.
        lock: refuse, and be refused by, other programs.

    Raises:
        PortError: The port does not exist, access is denied, or another program uses it.
    """

    def __init__(self, port: str, lock: bool = True) -> None:
        self.port = port
        self._missed = 0
        try:
            self._serial = serial.serial_for_url(
                port, do_not_open=True, timeout=0, write_timeout=_WRITE_TIMEOUT
            )
            self._serial.baudrate = CONSTANTS["baud"]
            raised = os.name == "posix" and isinstance(self._serial, serial.Serial)  # on opening
            self._serial.dtr = raised
            self._serial.rts = raised
            self._serial.exclusive = lock or None  # Windows refuses False, and locks
            self._serial.open()
            if raised:
                _lower(self._serial.fd)
            if raw := getattr(
                self._serial, "_socket", None
            ):  # a stop must not wait for the ACK of a move
                raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if lock:  # otherwise they are the other program's bytes too
                self._serial.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise PortError(_open_advice(port, error)) from error

    def read(self, timeout: float) -> bytes:
        data = bytearray()
        try:
            if self._serial.timeout != timeout:
                self._serial.timeout = timeout
            data += self._serial.read(1)
            # A socket tells only whether bytes wait, so this takes them one by one.
            while data and len(data) < READ_SIZE and (waiting := self._serial.in_waiting):
                data += self._serial.read(waiting)
        except (OSError, TypeError) as error:  # TypeError: raised by pyserial if it was closed
            if data:  # the last of a port that has gone, which the next read tells
                return bytes(data)
            if "multiple access" not in str(error) or self._missed > _MISSED_MAX:
                raise PortError(_gone(f"{self.port} has gone", error)) from error
            self._missed += (
                1  # a stop from another program may have read them; gone ports repeat it
            )
            time.sleep(_MISSED_WAIT)
            return b""
        self._missed = 0
        return bytes(data)

    def write(self, data: bytes) -> None:
        try:
            self._serial.write(data)
        except (OSError, TypeError) as error:
            raise PortError(_gone(f"{self.port} takes no bytes", error)) from error

    def close(self) -> None:
        self._serial.close()


def _lower(fd: int) -> None:
    """Set DTR and RTS of a port low at once; a pseudo-terminal has none."""
    import fcntl
    import termios

    with suppress(OSError):
        fcntl.ioctl(fd, termios.TIOCMBIC, struct.pack("I", termios.TIOCM_DTR | termios.TIOCM_RTS))


def _gone(what: str, error: Exception) -> str:
    text = str(error)
    unplugged = any(told in text for told in ("(5, ", "[Errno 5]", "returned no data"))
    return f"{what}: {'unplugged?' if unplugged else text}"


def _open_advice(port: str, error: Exception) -> str:
    for what, advice in _ADVICE.items():
        if re.search(what, repr(error)):
            return advice.format(port=port)
    text = str(error)
    if port.startswith("socket://"):
        told = "[Errno" in text or "timed out" in text  # anything else pyserial says of the name
        reason = text.rpartition("] ")[2] if told else "it is not socket://HOST:PORT, at most 65535"
        return f"{port} cannot be opened: {reason}"
    return _gone(f"{port} cannot be opened", error)


def open_transport(port: str | Callable[[], Transport], lock: bool = True) -> Transport:
    """Open a port by its name, see `SerialTransport`, or by a function that opens a transport.

    Raises:
        PortError: The name is malformed, or the port cannot be opened.
    """
    return SerialTransport(port, lock=lock) if isinstance(port, str) else port()
