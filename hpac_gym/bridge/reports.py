"""What the hand says about itself, in SI units and names."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpac_gym.bridge.frame import Frame
from hpac_gym.bridge.protocol import ANGLE_UNIT, Fault, Reset, State, name_of
from hpac_gym.model import SERVOS

COUNTERS = ("accepted", "refused", "bad_crc", "bad_frame", "bad_version", "overrun", "dropped", "watchdog_trips")
"""Names of the firmware's counters, as in firmware/core/hpac_hand.h."""


@dataclass(frozen=True, slots=True)
class HandInfo:
    """What the hand answers to HELLO."""

    firmware_version: str
    limits_hash: int
    watchdog: float
    """Silence that ends in the safe action [s]."""
    reset: str
    """Why the chip last started, of `protocol.Reset`."""
    boot_count: int
    state: str
    """Of `protocol.State`, at the time of the answer."""

    @classmethod
    def from_frame(cls, frame: Frame) -> HandInfo:
        """Read a `device_hello`."""
        fields = frame.fields
        return cls(
            firmware_version=".".join(map(str, fields["firmware_version"])),
            limits_hash=fields["limits_hash"],
            watchdog=fields["watchdog_ms"] * 1e-3,
            reset=name_of(Reset, fields["reset"]),
            boot_count=fields["boot_count"],
            state=name_of(State, fields["state"]),
        )


@dataclass(frozen=True, slots=True)
class HandStatus:
    """What the hand does now."""

    uptime: float
    """Time since boot [s], modulo 49 days."""
    state: str
    """Of `protocol.State`."""
    fault: str
    """Of `protocol.Fault`; `none` without one."""
    attached: tuple[str, ...]
    """Names of the servos that get pulses."""
    moving: bool
    servo: np.ndarray
    """Commanded angles, shape (6,) [rad]."""
    heat: np.ndarray
    """Estimated heat of each servo as a share of what is admissible, shape (6,)."""
    rate_share: float
    """What is left of the rate limit of the hottest servo, 0…1."""
    last_seq: int
    counters: dict[str, int]
    """By the names of `COUNTERS`, since boot."""

    @classmethod
    def from_frame(cls, frame: Frame) -> HandStatus:
        """Read a `device_status`."""
        fields = frame.fields
        return cls(
            uptime=fields["uptime_ms"] * 1e-3,
            state=name_of(State, fields["state"]),
            fault=name_of(Fault, fields["fault"]),
            attached=tuple(name for i, name in enumerate(SERVOS) if fields["attached"] >> i & 1),
            moving=bool(fields["moving"]),
            servo=np.array(fields["servo"]) * ANGLE_UNIT,
            heat=np.array(fields["heat_percent"]) * 1e-2,
            rate_share=fields["rate_permille"] * 1e-3,
            last_seq=fields["last_seq"],
            counters={name: fields[name] for name in COUNTERS},
        )
