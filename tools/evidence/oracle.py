"""An oracle for hands: checks pulses against docs/wire.md, given the bytes that the hand received
and sent.

Written from the document alone. It has a codec of its own (`hpac_gym.bridge.evidence.codec`), its own
servo table from the hand's parameters, and its own clock; it imports nothing from the link, the Python
codec or the firmware core."""

import struct
import zlib
from collections import Counter

import numpy as np

from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.model import HPAC, SERVOS, Hand

RULES = ("range", "rate", "start", "unarmed", "estop", "silence", "accept")
WATCHDOG_US = (100_000, 2_000_000)
HOLD_US = 30_000_000
RELAX_SHARE = 0.25
START_GAP_US = 60_000
STEP_MAX_US = 20_000
RATE_EXCESS = 1.01
NS_PER_RAD = 636_620.0
CENTRE_NS = 1_500_000.0
HASHED = (wire.VERSION, 20_000_000, 500_000, 2_500_000, 100, 1000, 10, 20, 250)
"""What the limits hash covers before the servos."""
ROUNDING = 3e-6
"""Tolerance for rounding of pulses to nanoseconds and angles to microradians [rad]."""
CREDIT_TIME = 1e-3
CREDIT_ANGLE = 1e-4
"""Permitted lead of a servo over its rate limit: 1 ms at the limit, plus 1e-4 rad."""

KNOWN = (wire.FAULT_ESTOP, wire.FAULT_WATCHDOG)
"""Faults whose cause the oracle has seen itself."""


class Conversation:
    """What host and hand say: which messages the hand must refuse, and whether it may have pulses.

    Attributes:
        session: nonce of the last wire.HELLO that opens a session; 0 before the first.
        armed: whether the hand may move.
        ending: the action by which the hand ends its motion since `ending_us`, by `ending_rule`; -1
            without one.
    """

    def __init__(
        self, oracle: "Oracle", low: list[float], high: list[float], limits_hash: int
    ) -> None:
        self._oracle = oracle
        self._limits_hash = limits_hash
        self._low = low
        self._high = high
        self._from_host = wire.Reader()
        self._from_hand = wire.Reader()
        self.power_on()

    def power_on(self) -> None:
        """Note a restart of the chip: no session."""
        self.session = 0
        self.armed = False
        self.ending = -1
        self.ending_us = 0
        self.ending_rule = ""
        self._waiting: dict[tuple[int, int], tuple[int, wire.Message]] = {}
        self._fed_us = self._watchdog_us = self._action = 0
        self._last_move: tuple[int, bytes] | None = None
        self._repeatable = False

    def starve(self, now_us: int, late_us: int) -> None:
        """Note the end of the watchdog period, once it is that late."""
        if self.armed and now_us - self._fed_us >= self._watchdog_us + late_us:
            self.end(self._action, self._fed_us + self._watchdog_us, "silence")

    def host(self, now_us: int, data: bytes) -> None:
        """Record bytes that reached the hand."""
        for message in self._from_host.push(data):
            if message.kind == wire.ESTOP:  # from any sender, with any contents
                self._oracle.tried["estop"] += 1
                self.end(wire.DETACH, now_us, "estop")
            elif message.version == wire.VERSION:
                self._waiting[message.kind, message.seq] = (now_us, message)
                if (
                    message.kind == wire.HELLO
                    and message.payload != bytes(4)
                    and len(message.payload) == 4
                    and not message.flags
                ):
                    self.session = struct.unpack("<I", message.payload)[0]
                    self.armed = False
                    self._last_move = None

    def end(self, action: int, now_us: int, rule: str) -> None:
        """Note that the hand has begun to end its motion on its own, and by which rule."""
        self.armed = False
        self.ending = action
        self.ending_us = now_us
        self.ending_rule = rule

    def device(self, now_us: int, data: bytes) -> None:
        """Record bytes that the hand sent: executed messages, and faults that it detected."""
        for message in self._from_hand.push(data):
            if message.kind == wire.ACK and len(message.payload) == 4 and message.payload[1] == 0:
                sent_us, question = self._waiting.pop(
                    (message.payload[0], message.seq), (now_us, None)
                )
                if question is not None:
                    self._carried_out(sent_us, question)
                elif message.payload[0] != wire.ESTOP:
                    self._oracle.complain(
                        "accept",
                        now_us,
                        f"message {message.payload[0]} was carried out, but never came",
                    )
            elif message.kind == wire.FAULT and message.payload[0] not in KNOWN:
                overload = message.payload[0] == wire.FAULT_OVERLOAD
                self.end(wire.RELAX if overload else wire.DETACH, now_us, "silence")

    def _carried_out(self, now_us: int, message: wire.Message) -> None:
        self._oracle.tried["accept"] += 1
        if (why := self._must_refuse(message)) is not None:
            self._oracle.complain(
                "accept",
                now_us,
                f"message {message.kind} of sequence {message.seq} was carried out: {why}",
            )
        if message.kind in (wire.ARM, wire.MOVE, wire.HEARTBEAT):
            self._fed_us = max(self._fed_us, now_us)
        if message.kind == wire.ARM:
            _, _, watchdog_ms, self._action = struct.unpack("<IIHB", message.payload)
            self._watchdog_us = watchdog_ms * 1000
            self.armed = True
            self.ending = -1
        elif message.kind == wire.CLEAR:
            self.armed = False
            self.ending = -1
            self._repeatable = False
        elif message.kind == wire.MOVE:
            self._last_move = (message.seq, message.payload)
            self._repeatable = True

    def _must_refuse(self, message: wire.Message) -> str | None:
        """Reason for which the hand must refuse this message, as far as an observer can know; None
        without one.
        """
        if len(message.payload) != wire.LENGTHS.get(message.kind, -1):
            return f"payload of {len(message.payload)} bytes"
        if message.flags & ~(
            3 if message.kind == wire.MOVE else wire.NO_ACK if message.kind == wire.HEARTBEAT else 0
        ):
            return f"flags {message.flags}"
        if message.kind == wire.STATUS:
            return None
        session = struct.unpack_from("<I", message.payload)[0]
        if not self.session or session != self.session:
            return f"session {session:08x} instead of {self.session:08x}"
        if message.kind == wire.ARM:
            _, limits_hash, watchdog_ms, action = struct.unpack("<IIHB", message.payload)
            if limits_hash != self._limits_hash:
                return f"limits hash {limits_hash:08x} instead of {self._limits_hash:08x}"
            if action > wire.DETACH or not WATCHDOG_US[0] <= watchdog_ms * 1000 <= WATCHDOG_US[1]:
                return f"action {action}, watchdog {watchdog_ms} ms"
            return "a fault is latched" if self.ending >= 0 else None
        if message.kind == wire.MOVE:
            return self._move_must_be_refused(message)
        return None

    def _move_must_be_refused(self, message: wire.Message) -> str | None:
        if not self.armed:
            return "the hand is not armed"
        _, duration_ms, *steps = struct.unpack("<IH6h", message.payload)
        if not 10 <= duration_ms <= 10_000:
            return f"duration {duration_ms} ms"
        for name, step, low, high in zip(SERVOS, steps, self._low, self._high, strict=True):
            if not low - 1e-9 <= step * 1e-4 <= high + 1e-9:
                return f"{name} to {step * 1e-4:g} rad"
        if self._last_move is not None and not (
            self._repeatable and self._last_move == (message.seq, message.payload)
        ):
            if not 0 < (message.seq - self._last_move[0]) % 0x10000 < 0x8000:
                return f"older than {self._last_move[0]}"
        return None


class Oracle:
    """Follows one hand from power-on and records every violation of the rules by its pulses.

    Args:
        hand: parameters of the hand.
        period_us: period of the board's ticks, which is also the tolerance in time [µs].
        holds_unpowered: whether its servos keep their angles without pulses.

    Attributes:
        said: takes the bytes that the hand receives and sends.
        complaints: rule, time [µs] and text of the first hundred violations, in order.
        broken: number of violations, by rule.
        tried: number of checks of each of `RULES`.
    """

    def __init__(
        self, hand: Hand = HPAC, period_us: int = 1000, holds_unpowered: bool = False
    ) -> None:
        self.complaints: list[tuple[str, int, str]] = []
        self.broken: Counter[str] = Counter()
        self.tried: Counter[str] = Counter(dict.fromkeys(RULES, 0))
        self._holds = holds_unpowered
        low, high = (np.rint(1e4 * end) / 1e4 for end in (hand.servo_min, hand.servo_max))
        rate = np.broadcast_to(hand.servo_rate_limit, len(SERVOS))
        self._low, self._high, self._centre, self._rest, self._rate = (
            each.tolist() for each in (low, high, (low + high) / 2, np.clip(0.0, low, high), rate)
        )
        self._period_us = period_us
        self._way_to_rest_us = 1e6 * float(((high - low) / (RELAX_SHARE * rate)).max())
        urad = (1e6 * np.array([self._low, self._high, self._rest, self._centre, self._rate])).T
        numbers = [[*np.rint(row).astype(int), NS_PER_RAD, CENTRE_NS, 0, 1] for row in urad]
        packed = struct.pack("<63i", *HASHED, *map(int, np.ravel(numbers)))
        self.said = Conversation(self, self._low, self._high, zlib.crc32(packed))
        self.power_on()

    def complain(self, rule: str, now_us: int, text: str) -> None:
        """Note a violation."""
        self.broken[rule] += 1
        if len(self.complaints) < 100:
            self.complaints.append((rule, now_us, text))

    def power_on(self) -> None:
        """Note a restart of the chip: no session, no pulses."""
        self.said.power_on()
        self._now_us: int | None = None
        self._angles: list[float | None] = [None] * len(SERVOS)
        self._pose = list(self._rest)
        self._over = [0.0] * len(SERVOS)
        self._started_us = 0

    def pulses(self, now_us: int, widths: list[int] | np.ndarray) -> None:
        """Check the six pulse widths [ns] after a tick; 0 means no pulses."""
        self.said.starve(now_us, self._period_us)
        before_us = self._now_us if self._now_us is not None else now_us
        angles = [
            None if not width else centre + (int(width) - CENTRE_NS) / NS_PER_RAD
            for width, centre in zip(widths, self._centre, strict=True)
        ]
        self._check_power(now_us, angles)
        self._check_start(now_us, angles)
        for i, angle in enumerate(angles):
            if angle is not None:
                self._check_motion(i, angle, now_us, now_us - before_us)
                self._pose[i] = angle
        self._angles = angles
        self._now_us = now_us

    def _check_power(self, now_us: int, angles: list[float | None]) -> None:
        powered = any(angle is not None for angle in angles)
        if self.said.armed:
            return
        if self.said.ending < 0:
            self.tried["unarmed"] += 1
            if powered:
                self.complain("unarmed", now_us, "pulses although the hand is not armed")
            return
        way_us = self._way_to_rest_us
        allowed_us = {wire.DETACH: 0.0, wire.HOLD: way_us + HOLD_US}.get(self.said.ending, way_us)
        self.tried[self.said.ending_rule] += 1
        if powered and now_us > self.said.ending_us + allowed_us + 2 * self._period_us:
            self.complain(
                self.said.ending_rule,
                now_us,
                f"pulses {(now_us - self.said.ending_us) / 1e3:.1f} ms after the end began",
            )

    def _check_start(self, now_us: int, angles: list[float | None]) -> None:
        new = [
            i
            for i, (was, angle) in enumerate(zip(self._angles, angles, strict=True))
            if was is None and angle is not None
        ]
        if not new:
            return
        self.tried["start"] += 1
        # One that lost its pulses in the meantime is no longer on its way.
        others = any(angle is not None for angle in self._angles)
        soon = now_us - self._started_us < START_GAP_US - self._period_us
        if len(new) > 1 or (others and soon):
            self.complain(
                "start",
                now_us,
                f"servos {new} start {(now_us - self._started_us) / 1e3:.0f} ms after the one before",
            )
        for i in new:
            # Pulses stop at the tick at which the relaxing servo is at rest, so the last output is
            # one tick older.
            stands = self._pose[i] if self._holds else self._rest[i]
            if (
                abs(angles[i] - stands)
                > RELAX_SHARE * self._rate[i] * 2e-6 * self._period_us + ROUNDING
            ):
                self.complain(
                    "start",
                    now_us,
                    f"{SERVOS[i]} starts at {angles[i]:.4f} rad, stands at {stands:.4f} rad",
                )
        self._started_us = now_us

    def _check_motion(self, i: int, angle: float, now_us: int, step_us: int) -> None:
        self.tried["range"] += 1
        if not self._low[i] - ROUNDING <= angle <= self._high[i] + ROUNDING:
            self.complain(
                "range",
                now_us,
                f"{SERVOS[i]} at {angle:.4f} rad, limits {self._low[i]:g} … {self._high[i]:g} rad",
            )
        before = self._angles[i]
        if before is None:
            self._over[i] = 0.0
            return
        moved = abs(angle - before)
        slow = self.said.ending == wire.RELAX or (
            self.said.ending == wire.HOLD and now_us > self.said.ending_us + HOLD_US
        )
        rate = self._rate[i] * (RELAX_SHARE if slow else 1.0)
        allowed = rate * RATE_EXCESS * min(step_us, STEP_MAX_US) * 1e-6
        self._over[i] = max(self._over[i] + moved - allowed, 0.0)
        self.tried["rate"] += moved > ROUNDING
        if self._over[i] > rate * CREDIT_TIME + CREDIT_ANGLE + ROUNDING:
            self.complain(
                "rate", now_us, f"{SERVOS[i]} is {self._over[i]:.4f} rad ahead of {rate:g} rad/s"
            )
            self._over[i] = 0.0
        if self.said.ending < 0 or now_us <= self.said.ending_us + self._period_us:
            return
        if (
            self.said.ending == wire.HOLD
            and now_us < self.said.ending_us + HOLD_US
            and moved > ROUNDING
        ):
            self.complain("silence", now_us, f"{SERVOS[i]} moves although the hand must hold")
        if slow and abs(angle - self._rest[i]) > abs(before - self._rest[i]) + ROUNDING:
            self.complain(
                "silence", now_us, f"{SERVOS[i]} moves away from rest although the hand must relax"
            )
