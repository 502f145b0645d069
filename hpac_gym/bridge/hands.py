"""The firmware on this computer, as two kinds of hand: a process in real time, and a library in
virtual time.

`HostBoard` runs behind a pseudo-terminal. `VirtualHand` runs in this process: the same C code with
a clock that advances only while a link waits, so it is deterministic and faster than real time.
Both are the firmware itself, not a model of it."""

from __future__ import annotations

import ctypes
import math
import os
import select
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import astuple, fields
from functools import cache
from pathlib import Path
from typing import IO, cast

import numpy as np

from hpac_gym.bridge.errors import PortError
from hpac_gym.bridge.firmware import firmware_file
from hpac_gym.bridge.limits import ServoLimits, servo_limits
from hpac_gym.bridge.protocol import Reset
from hpac_gym.bridge.transport import SerialTransport, Transport
from hpac_gym.errors import ParameterError
from hpac_gym.model import SERVOS, Hand

_START_TIMEOUT = 5.0
_END_TIMEOUT = 1.0
_LONGEST_LOG = 1 << 24
"""Bytes after which the log of a board that somebody reads begins anew."""
_Pulses = ctypes.c_uint32 * len(SERVOS)


class HostBoard:
    """Starts the host firmware on entry and ends it on exit; it also ends by itself when this
    process ends.

    Args:
        arguments: additional command-line arguments of `hpac_host`, for example `("--boot-text",)`.

    Attributes:
        port: path of the pseudo-terminal.
        process: the running firmware.
    """

    def __init__(self, arguments: tuple[str, ...] = ()) -> None:
        self._arguments = arguments

    def __enter__(self) -> HostBoard:
        program = firmware_file("hpac_host")
        self._owner = os.getpid()
        self._read_to = 0
        self._pulses = np.zeros(len(SERVOS), dtype=np.int64)
        with tempfile.TemporaryDirectory(prefix="hpac_host_", ignore_cleanup_errors=True) as folder:
            self._log = Path(folder, "pulses.csv").open("w+b", buffering=0)
            command = [program, "--pulses", self._log.name, "--parent", str(self._owner)]
            self.process = subprocess.Popen(
                [*command, *self._arguments],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,  # Ctrl-C must not end it before the host has released it
            )
            said = cast("IO[str]", self.process.stdout)
            ready, _, _ = select.select([said], [], [], _START_TIMEOUT)
            self.port = said.readline().strip() if ready else ""
        # The log is open on both sides: nothing outlives a kill.
        if not self.port:
            self.__exit__()
            raise PortError(f"{program} did not open a pseudo-terminal")
        return self

    def __exit__(self, *_: object) -> None:
        if self._owner != os.getpid():  # a forked child: the board belongs to its parent
            return
        self.process.terminate()
        try:
            self.process.wait(_END_TIMEOUT)
        except subprocess.TimeoutExpired:  # for example stopped in a debugger
            self.process.kill()
            self.process.wait()
        cast("IO[str]", self.process.stdout).close()
        self._log.close()

    def connect(self) -> SerialTransport:
        """A serial transport to this board, for `HandLink(board.connect)`.

        Raises:
            PortError: The board has ended; its pseudo-terminal may belong to another program by
                now.
        """
        if self.process.poll() is not None:
            raise PortError(f"{self.port}: no such port; the board behind it has ended")
        return SerialTransport(self.port)

    def pulses(self) -> np.ndarray:
        """The present pulse widths, shape (6,) [ns]; 0 means no pulses.

        The firmware logs a change before it sends the answer that reports it: after `HandLink.wait`
        or `HandLink.status` this is at least as new as that answer."""
        changes = self.pulse_changes()
        if len(changes):
            self._pulses = changes[-1, 1:]
        return self._pulses.copy()

    def pulse_changes(self) -> np.ndarray:
        """All changes of the pulse widths since the last call, shape (n, 7): time [µs], then six
        widths [ns].
        """
        self._log.seek(self._read_to)
        lines, newline, _ = self._log.read().rpartition(b"\n")
        self._read_to += len(lines) + len(newline)
        if self._read_to > _LONGEST_LOG and not self._log.read():
            self._log.truncate(0)
            self._read_to = 0
        rows = [[int(value) for value in line.split(b",")] for line in lines.splitlines()]
        return np.array(rows, dtype=np.int64).reshape(-1, 1 + len(SERVOS))


class ServoConfig(ctypes.Structure):
    """`hpac_servo_t` of firmware/core/hpac_servo.h: the limits, in their order, then trim and
    direction.
    """

    _limits = tuple(field.name for field in fields(ServoLimits))[1:]
    _fields_ = [
        (name, ctypes.c_int32) for name in (*_limits, "trim_ns", "direction", "holds_unpowered")
    ]


Config = ServoConfig * len(SERVOS)
"""`hpac_config_t` of firmware/core/hpac_hand.h."""


@cache
def load_library() -> ctypes.CDLL:
    """Load the core as a shared library with typed functions.

    Raises:
        FirmwareMissing: The library has not been built, and cannot be.
    """
    # Holds the GIL, so that only one thread is in the core.
    library = ctypes.PyDLL(str(firmware_file("libhpac.so")))
    pointer = ctypes.c_void_p
    size = ctypes.c_size_t
    u64 = ctypes.c_uint64
    signatures = {
        "hpac_library_hand_size": (size, []),
        "hpac_library_run": (u64, [pointer, pointer, u64, u64, u64, _Pulses]),
        "hpac_config_default": (None, [pointer]),
        "hpac_hand_init": (None, [pointer, pointer, ctypes.c_int, ctypes.c_uint16, pointer]),
        "hpac_hand_receive": (None, [pointer, pointer, u64, ctypes.c_char_p, size]),
        "hpac_hand_tick": (None, [pointer, pointer, u64, _Pulses]),
        "hpac_hand_transmit": (size, [pointer, pointer, size]),
    }
    for name, (result, arguments) in signatures.items():
        function = getattr(library, name)
        function.restype = result
        function.argtypes = arguments
    return library


def default_config() -> ctypes.Array[ServoConfig]:
    """Copy of the servo table that the firmware was built with, whose trims and directions a test
    may change.
    """
    config = Config()
    load_library().hpac_config_default(config)
    return config


def config_of(hand: Hand) -> ctypes.Array[ServoConfig]:
    """The servo table of a firmware that is generated for a hand."""
    return Config(*(ServoConfig(*astuple(servo)[1:], 0, 1, 0) for servo in servo_limits(hand)))


class VirtualHand:
    """One hand with its own virtual clock. Use it like `HostBoard`.

    Args:
        period_us: period of the board's ticks [µs].
        config: servo table, see `default_config`.
        on_pulses: called as `on_pulses(now_us, pulses)` after every tick; widths as in `pulses`.
        start_us: initial value of the clock [µs].
        quiet_until_us: time before which `on_pulses` is not called, and at which there is a tick
            [µs]: what needs the pulses only now and then sets it, and runs several times faster.

    Raises:
        ParameterError: `period_us` is below 1.
    """

    def __init__(
        self,
        period_us: int = 1000,
        config: ctypes.Array[ServoConfig] | None = None,
        reset: Reset = Reset.power_on,
        on_pulses: Callable[[int, np.ndarray], None] | None = None,
        start_us: int = 0,
        quiet_until_us: int = 0,
    ) -> None:
        if period_us < 1:
            raise ParameterError(f"period_us = {period_us} µs must be at least 1 µs")
        self._library = load_library()
        self._hand = ctypes.create_string_buffer(self._library.hpac_library_hand_size())
        self._config = config if config is not None else default_config()
        self._pulses = _Pulses()
        self._out = ctypes.create_string_buffer(1024)
        self._period_us = period_us
        self._on_pulses = on_pulses
        self.now_us = start_us
        """Virtual time [µs]."""
        self.quiet_until_us = quiet_until_us
        self.plugged = True
        """Set to False to simulate an unplugged cable: every transport then raises `PortError`."""
        self.restart(reset)

    def __enter__(self) -> VirtualHand:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def restart(self, reset: Reset = Reset.power_on, boot_count: int = 1) -> None:
        """Reset the chip without resetting the clock."""
        self._library.hpac_hand_init(self._hand, self._config, reset, boot_count, None)
        self.tick()

    def connect(self) -> VirtualTransport:
        """A transport to this hand, for `HandLink(hand.connect)`."""
        return VirtualTransport(self)

    def pulses(self) -> np.ndarray:
        """The present pulse widths, shape (6,) [ns]; 0 means no pulses."""
        return np.array(self._pulses, dtype=np.int64)

    def receive(self, data: bytes) -> None:
        """Pass bytes from the host to the firmware."""
        self._library.hpac_hand_receive(self._hand, self._config, self.now_us, data, len(data))
        self.tick()

    def transmit(self) -> bytes:
        """Read the bytes that the firmware has to send."""
        length = self._library.hpac_hand_transmit(self._hand, self._out, len(self._out))
        return self._out.raw[:length]

    def tick(self) -> None:
        """Call the firmware's tick, as the board does every period."""
        self._library.hpac_hand_tick(self._hand, self._config, self.now_us, self._pulses)
        self._tell()

    def _tell(self) -> None:
        if self._on_pulses and self.now_us >= self.quiet_until_us:
            self._on_pulses(self.now_us, self.pulses())

    def run(self, seconds: float) -> bytes:
        """Advance the clock in ticks until the firmware sends bytes or `seconds` have passed;
        returns the bytes.
        """
        said = self.transmit()
        until_us = self.now_us + math.ceil(seconds * 1e6)
        while not said and self.now_us < until_us:
            stop_us = until_us
            if self._on_pulses:
                stop_us = min(until_us, max(self.quiet_until_us, self.now_us + self._period_us))
            self.now_us = self._library.hpac_library_run(
                self._hand, self._config, self.now_us, stop_us, self._period_us, self._pulses
            )
            self._tell()
            said = self.transmit()
        return said


class VirtualTransport(Transport):
    """In-process equivalent of a serial port: reading advances the virtual clock."""

    def __init__(self, hand: VirtualHand) -> None:
        self._hand = hand
        self._check()

    def _check(self) -> None:
        if not self._hand.plugged:
            raise PortError("the virtual hand has gone: unplugged")

    def read(self, timeout: float) -> bytes:
        self._check()
        return self._hand.run(timeout)

    def write(self, data: bytes) -> None:
        self._check()
        self._hand.receive(data)

    def now(self) -> float:
        """Virtual time [s]."""
        return self._hand.now_us * 1e-6
