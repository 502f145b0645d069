"""The firmware core in this process: the same C code with a virtual clock, which advances only while a link waits.

Deterministic and faster than real time. This is the firmware itself, not a model of it.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from dataclasses import astuple, fields
from functools import cache

import numpy as np

from hpac_gym.bridge.errors import PortError
from hpac_gym.bridge.host_board import firmware_file
from hpac_gym.bridge.limits import ServoLimits, servo_limits
from hpac_gym.bridge.protocol import Reset
from hpac_gym.bridge.transport import Transport
from hpac_gym.model import SERVOS, Hand

_Pulses = ctypes.c_uint32 * len(SERVOS)


class ServoConfig(ctypes.Structure):
    """`hpac_servo_t` of firmware/core/hpac_servo.h: the limits, in their order, then trim and direction."""

    _limits = tuple(field.name for field in fields(ServoLimits))[1:]
    _fields_ = [(name, ctypes.c_int32) for name in (*_limits, "trim_ns", "direction")]


Config = ServoConfig * len(SERVOS)
"""`hpac_config_t` of firmware/core/hpac_hand.h."""


@cache
def load_library() -> ctypes.CDLL:
    """Load the core as a shared library with typed functions.

    Raises:
        FirmwareMissing: The library has not been built.
    """
    library = ctypes.PyDLL(str(firmware_file("libhpac.so")))  # holds the GIL, so that only one thread is in the core
    pointer, size, u64 = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_uint64
    signatures = {
        "hpac_library_hand_size": (size, []),
        "hpac_library_config_size": (size, []),
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
    """Copy of the servo table that the firmware was built with, whose trims and directions a test may change."""
    config = Config()
    load_library().hpac_config_default(config)
    return config


def config_of(hand: Hand) -> ctypes.Array[ServoConfig]:
    """The servo table of a firmware that is generated for a hand."""
    return Config(*(ServoConfig(*astuple(servo)[1:], 0, 1) for servo in servo_limits(hand)))


class VirtualHand:
    """One hand with its own virtual clock. Use it like `HostBoard`.

    Args:
        period_us: period of the board's ticks [µs].
        config: servo table, see `default_config`.
        on_pulses: called as `on_pulses(now_us, pulses)` after every tick; widths as in `pulses`.
        start_us: initial value of the clock [µs].
    """

    def __init__(
        self,
        period_us: int = 1000,
        config: ctypes.Array[ServoConfig] | None = None,
        reset: Reset = Reset.power_on,
        on_pulses: Callable[[int, np.ndarray], None] | None = None,
        start_us: int = 0,
    ) -> None:
        self._library = load_library()
        self._hand = ctypes.create_string_buffer(self._library.hpac_library_hand_size())
        self._config = config if config is not None else default_config()
        self._pulses = _Pulses()
        self._out = ctypes.create_string_buffer(1024)
        self._period_us = period_us
        self._on_pulses = on_pulses
        self.now_us = start_us
        """Virtual time [µs]."""
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
        if self._on_pulses:
            self._on_pulses(self.now_us, self.pulses())

    def run(self, seconds: float) -> bytes:
        """Advance the clock in ticks until the firmware sends bytes or `seconds` have passed; returns the bytes."""
        said = self.transmit()
        until_us = self.now_us + math.ceil(seconds * 1e6)
        while not said and self.now_us < until_us:
            if self._on_pulses:
                self.now_us = min(self.now_us + self._period_us, until_us)
                self.tick()
            else:
                until = (until_us, self._period_us, self._pulses)
                self.now_us = self._library.hpac_library_run(self._hand, self._config, self.now_us, *until)
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
