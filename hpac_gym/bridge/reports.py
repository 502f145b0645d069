"""Reports of the hand in SI units and names, and the state of the hand known from them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hpac_gym.bridge.errors import FaultError, HandshakeError, RejectedError
from hpac_gym.bridge.limits import ServoLimits, limits_hash
from hpac_gym.bridge.protocol import (
    ANGLE_UNIT,
    CONSTANTS,
    LOAD,
    Fault,
    Frame,
    Reason,
    Reset,
    State,
    name_of,
)
from hpac_gym.model import HPAC, SERVOS, Hand

COUNTERS = (
    "accepted",
    "refused",
    "bad_crc",
    "bad_frame",
    "bad_version",
    "overrun",
    "dropped",
    "watchdog_trips",
)
"""Names of the firmware's counters, as in firmware/core/hpac_hand.h."""

_BOUNDS = (
    (
        "duration_ms",
        Reason.duration,
        f"{CONSTANTS['move_min_ms']} to {CONSTANTS['move_max_ms']}",
    ),
    (
        "watchdog_ms",
        Reason.period,
        f"{CONSTANTS['watchdog_min_ms']} to {CONSTANTS['watchdog_max_ms']}",
    ),
    ("period_ms", Reason.period, f"0 or at least {CONSTANTS['status_min_ms']}"),
)
"""Times of messages: field, the reason for which it is refused, what is allowed."""


@dataclass(frozen=True, slots=True)
class HandInfo:
    """The hand's answer to HELLO."""

    firmware_version: str
    limits_hash: int
    watchdog: float
    """Watchdog period: silence after which the safe action starts [s]."""
    reset: str
    """Cause of the last reset, a name of `protocol.Reset`."""
    boot_count: int
    state: str
    """Name of the state at the time of the answer, of `protocol.State`."""
    session: int
    """Nonce of the active session; 0 for none."""
    trim_ns: tuple[int, ...]
    """Zero trims of the individual hand, shape (6,) [ns]."""
    reversed_mask: int
    """Bit i is set if servo i is mounted in reverse."""

    @classmethod
    def from_frame(cls, frame: Frame) -> HandInfo:
        """Read a `device_hello`."""
        number = frame.number
        return cls(
            firmware_version=".".join(map(str, frame.numbers("firmware_version"))),
            limits_hash=number("limits_hash"),
            watchdog=number("watchdog_ms") * 1e-3,
            reset=name_of(Reset, number("reset")),
            boot_count=number("boot_count"),
            state=name_of(State, number("state")),
            session=number("session"),
            trim_ns=frame.numbers("trim_ns"),
            reversed_mask=number("reversed"),
        )

    def table_of(self, hand: Hand) -> Hand:
        """The hand whose servo table the board has: `hand`, or for a calibrated one the nominal,
        within whose range it can be commanded at the same speed.

        Raises:
            HandshakeError: It has the table of another hand; the message states how to make the
                firmware match.
        """
        as_fast = np.array_equal(hand.servo_rate_limit, HPAC.servo_rate_limit)
        nominal = [HPAC] if hand.is_calibrated and as_fast else []
        for built_for in (hand, *nominal):
            if self.limits_hash == limits_hash(built_for, self.trim_ns, self.reversed_mask):
                return built_for
        wanted = limits_hash(hand, self.trim_ns, self.reversed_mask)
        raise HandshakeError(
            f"the firmware's servo limits {self.limits_hash:08x} are not this hand's {wanted:08x}: name the hand that it was "
            "built for (--hand FILE), or build and flash it for this one (python -m tools.generate --hand FILE)"
        )


@dataclass(frozen=True, slots=True)
class HandStatus:
    """The hand's answer to STATUS."""

    uptime: float
    """Time since boot [s], modulo 49 days."""
    state: str
    """Name of the state, of `protocol.State`."""
    fault: str
    """Name of the fault, of `protocol.Fault`; `none` without one."""
    attached: tuple[str, ...]
    """Names of the servos that get pulses."""
    moving: bool
    servo: np.ndarray
    """Commanded angles, shape (6,) [rad], read-only."""
    heat: np.ndarray
    """Estimated heat of each servo as a share of the admissible heat, shape (6,), read-only."""
    rate_share: float
    """Remaining share of the rate limit of the hottest servo, 0…1."""
    supply: float
    """Voltage of the servo supply [V]; NaN if the board does not measure it."""
    last_seq: int
    """Number of the last MOVE that the hand has accepted."""
    counters: dict[str, int]
    """Counts since boot, by the names of `COUNTERS`."""
    number: int = 0
    """Number of the request that it answers; 0 if it is periodic."""

    def __post_init__(self) -> None:
        for array in (self.servo, self.heat):
            array.setflags(write=False)

    @classmethod
    def from_frame(cls, frame: Frame) -> HandStatus:
        """Read a `device_status`."""
        number = frame.number
        attached = number("attached")
        return cls(
            uptime=number("uptime_ms") * 1e-3,
            state=name_of(State, number("state")),
            fault=name_of(Fault, number("fault")),
            attached=tuple(name for i, name in enumerate(SERVOS) if attached >> i & 1),
            moving=bool(number("moving")),
            servo=np.array(frame.numbers("servo")) * ANGLE_UNIT,
            heat=np.array(frame.numbers("heat_percent")) * 1e-2,
            rate_share=number("rate_permille") * 1e-3,
            supply=number("supply_mv") * 1e-3 or math.nan,
            last_seq=number("last_seq"),
            counters={name: number(name) for name in COUNTERS},
            number=frame.seq,
        )


class KnownState:
    """The latest known state of the hand, derived only from its messages.

    Attributes:
        state: name of `protocol.State`; `boot` if not connected.
        fault: name of `protocol.Fault`; also `none` if the kind of a fault is not known yet.
        status: the latest STATUS, or None.
        limits: the servo limits that host and hand have agreed on; empty before the first
            `HandLink.arm`.
        may_have_power: False once the hand has confirmed, in answer to a message sent after the
            last ARM, that its pulses are off.
    """

    def __init__(self) -> None:
        self.status: HandStatus | None = None
        self.limits: tuple[ServoLimits, ...] = ()
        self.forget()

    def forget(self) -> None:
        """Forget the state when the connection is gone."""
        self.state = State.boot.name
        self.fault = Fault.none.name
        self.may_have_power = True

    def take_in(self, frame: Frame, answered: str | None = None) -> None:
        """Update the state from a frame of the hand; `answered` names the message that it
        answers.
        """
        if "state" in frame.fields:
            self.state = name_of(State, frame.number("state"))
        if frame.name == "device_status":
            self.status = HandStatus.from_frame(frame)
            self.fault = self.status.fault
        elif frame.name == "fault":
            self.state = State.fault.name
            self.fault = name_of(Fault, frame.number("fault"))
        elif self.state != State.fault.name:
            self.fault = Fault.none.name
        # An answer to ARM or MOVE proves nothing: a repeated frame may still be in transit.
        if answered in ("hello", "clear", "estop", "status"):
            self.may_have_power = not _without_pulses(frame, answered)

    @property
    def in_fault(self) -> bool:
        """Whether the hand has reported a latched fault."""
        return self.state == State.fault.name

    def refusal(self, message: Frame, ack: Frame) -> RejectedError:
        """The error for an ACK with a reason, which names the refused value of the message and its
        bound.
        """
        reason = name_of(Reason, ack.number("reason"))
        index = ack.number("servo")
        servo = SERVOS[index] if index < len(SERVOS) else None
        if reason == Reason.session.name:
            where = ": another program has greeted the hand since, or the board has restarted; this link is over"
        elif self.in_fault:
            pressed = ": the e-stop input is pressed" if reason == Reason.estop.name else ""
            return self.fault_error(f"{message.name} refused{pressed}", reason, servo)
        else:
            where = (f" at servo {servo}" if servo else "") + self._bound(reason, message, index)
        return RejectedError(
            f"the hand refused {message.name}: {reason}{where} (state {self.state})",
            reason,
            servo,
            self.state,
        )

    def _bound(self, reason: str, message: Frame, servo: int) -> str:
        """Value, bound and unit of the field that a message was refused for; empty if it is not
        about a value.
        """
        for field, refused_for, allowed in _BOUNDS:
            if reason == refused_for.name and field in message.fields:
                what = "watchdog " if field == "watchdog_ms" else ""
                return f": {what}{message.number(field)} ms, allowed {allowed} ms"
        hot = message.name == "arm" and reason == Reason.hot.name and servo < len(SERVOS)
        if hot and self.status is not None:
            most = LOAD["derate_from_percent"]
            return f": heat {self.status.heat[servo]:.0%}, allowed below {most}%"
        if servo >= len(self.limits) or "servo" not in message.fields:
            return ""
        limit = self.limits[servo]
        target = message.numbers("servo")[servo] * ANGLE_UNIT
        if reason == Reason.angle.name:
            return f": {target:g} rad, allowed {limit.min_urad * 1e-6:g} to {limit.max_urad * 1e-6:g} rad on the whole way"
        within = f"within {message.number('duration_ms')} ms"
        return f": {target:g} rad {within}, allowed {limit.rate_urad_s * 1e-6:g} rad/s"

    def fault_error(
        self, what: str, reason: str = Reason.state.name, servo: str | None = None
    ) -> FaultError:
        """The error for a latched fault."""
        advice = "; `hpac clear` or HandLink.clear() leaves it"
        if self.fault == Fault.config.name:
            advice = "; `hpac doctor` says what to correct"
        elif what.startswith("clear "):
            advice = ""
        return FaultError(
            f"the hand is in fault ({self.fault}): {what}{advice}",
            reason,
            servo,
            self.state,
        )


def _without_pulses(frame: Frame, answered: str) -> bool:
    state = frame.number("state")
    if frame.name == "device_status":
        return state != State.armed and not frame.number("attached")
    if answered == "estop":
        return state == State.fault and frame.number("reason") == Reason.ok
    return state in (State.boot, State.idle)
