"""A device under test: requests sent with the oracle's codec, and checks of the answers."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from hpac_gym.bridge.evidence.oracle import (
    ACK,
    ARM,
    CLEAR,
    DEVICE_HELLO,
    DEVICE_STATUS,
    ESTOP,
    FAULT,
    HEARTBEAT,
    HELLO,
    MOVE,
    NO_ACK,
    STATUS,
    VERSION,
    Message,
    Reader,
    wire,
)
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.bridge.protocol import CONSTANTS, Action, Fault, Reason, State, name_of
from hpac_gym.bridge.transport import Transport
from hpac_gym.model import Hand

_NAMES = {HELLO: "HELLO", ARM: "ARM", MOVE: "MOVE", HEARTBEAT: "HEARTBEAT", ESTOP: "ESTOP", CLEAR: "CLEAR", STATUS: "STATUS"}
_ANSWERS = {HELLO: DEVICE_HELLO, STATUS: DEVICE_STATUS}
SLACK = 0.15
"""Tolerance for the delays of device and line [s]."""
SESSION = 0x48504143
OURS = struct.pack("<I", SESSION)
"""The payload of HEARTBEAT and CLEAR in this suite's session."""


class BrokenRule(Exception):
    """The device violated a rule; the message states the actual and the required behaviour."""


@dataclass(frozen=True, slots=True)
class Hello:
    session: int
    limits_hash: int
    trim_ns: tuple[int, ...]
    reversed_mask: int
    watchdog_ms: int
    state: int


@dataclass(frozen=True, slots=True)
class Status:
    state: int
    fault: int
    attached: int
    moving: int
    servo: tuple[int, ...]
    last_seq: int
    accepted: int
    refused: int
    bad_crc: int
    bad_frame: int
    bad_version: int
    overrun: int
    trips: int


class Device:
    """The device under test: requests, answers and checks."""

    def __init__(self, transport: Transport, hand: Hand, patience: float) -> None:
        self._transport = transport
        self._reader = Reader()
        self._patience = patience
        self._seq = 0
        self.limits = servo_limits(hand)
        self.hand = hand
        self.hash = 0
        self.tried = 0
        self.unasked: list[Message] = []

    def expect(self, kept: bool, what: str) -> None:
        """Check the current rule and count the check.

        Raises:
            BrokenRule: The rule is violated.
        """
        self.tried += 1
        if not kept:
            raise BrokenRule(what)

    def listen(self, seconds: float) -> None:
        """Receive messages for `seconds` and append them to `unasked`."""
        until = self._transport.now() + seconds
        while (left := until - self._transport.now()) > 0:
            self.unasked += self._reader.push(self._transport.read(left))

    def live(self, seconds: float) -> None:
        """Wait as an active controller, sending heartbeats."""
        until = self._transport.now() + seconds
        while (left := until - self._transport.now()) > 0:
            self.send(HEARTBEAT, OURS, NO_ACK)
            self.listen(min(left, 0.03))

    def send(self, kind: int, payload: bytes = b"", flags: int = 0, version: int = VERSION, seq: int | None = None) -> int:
        """Send a frame; returns its sequence number."""
        self._seq = self._seq % 0xFFFF + 1
        seq = self._seq if seq is None else seq
        self._transport.write(wire(kind, seq, payload, flags, version))
        return seq

    def raw(self, data: bytes) -> None:
        """Send raw bytes."""
        self._transport.write(data)

    def ask(
        self, kind: int, payload: bytes = b"", flags: int = 0, version: int = VERSION, seq: int | None = None
    ) -> Message | None:
        """Send a frame and return the first answer with its sequence number, or None."""
        seq = self.send(kind, payload, flags, version, seq)
        until = self._transport.now() + self._patience
        while (left := until - self._transport.now()) > 0:
            heard = self._reader.push(self._transport.read(left))
            answers = [message for message in heard if message.seq == seq and message.kind in (ACK, _ANSWERS.get(kind))]
            self.unasked += [message for message in heard if message not in answers]
            if answers:
                self.unasked += answers[1:]
                return answers[0]
        return None

    def refusal(self, kind: int, payload: bytes = b"", **how: int) -> tuple[int, int] | None:
        """Send a frame and return reason and servo of the answering ACK; None without one."""
        answer = self.ask(kind, payload, **how)
        if answer is None or answer.kind != ACK or len(answer.payload) != 4:
            return None
        return answer.payload[1], answer.payload[2]

    def must(self, reason: Reason, kind: int, payload: bytes = b"", text: str = "", **how: int) -> None:
        """Require that the device answers this message with an ACK of this reason."""
        got = self.refusal(kind, payload, **how)
        told = "no ACK" if got is None else name_of(Reason, got[0])
        self.expect(got is not None and got[0] == reason, f"{_NAMES.get(kind, kind)} {text}: {told}, must be {reason.name}")

    def hello(self, nonce: int) -> Hello:
        """Send HELLO and return the answer."""
        answer = self.ask(HELLO, struct.pack("<I", nonce))
        self.expect(answer is not None, "HELLO got no answer")
        self.expect(answer.kind == DEVICE_HELLO and len(answer.payload) == 30, f"HELLO answered by {_told(answer)}")
        session, *_, limits = (*struct.unpack_from("<I3BI", answer.payload),)
        *trims, reversed_mask, watchdog_ms, _, _, state = struct.unpack_from("<6hBHBHB", answer.payload, 11)
        return Hello(session, limits, tuple(trims), reversed_mask, watchdog_ms, state)

    def status(self, period_ms: int = 0) -> Status:
        """Request STATUS and return the answer."""
        answer = self.ask(STATUS, struct.pack("<H", period_ms))
        self.expect(answer is not None, "STATUS got no answer")
        self.expect(answer.kind == DEVICE_STATUS and len(answer.payload) == 50, f"STATUS answered by {_told(answer)}")
        _, state, fault, attached, moving, *rest = struct.unpack("<IBBBB6h6BHHHIHHHHHHH", answer.payload)
        last_seq, *counters, _, trips = rest[14:]
        return Status(state, fault, attached, moving, tuple(rest[:6]), last_seq, *counters, trips)

    def arm(self, action: int = Action.relax, watchdog_ms: int = 250, hash_: int | None = None, session: int = SESSION) -> bytes:
        """Payload of an ARM."""
        return struct.pack("<IIHB", session, self.hash if hash_ is None else hash_, watchdog_ms, action)

    def move(self, target: int | list[int], duration_ms: int = 400, session: int = SESSION) -> bytes:
        """Payload of a MOVE to `target` above each servo's rest [1e-4 rad]."""
        rest = [servo.rest_urad // 100 for servo in self.limits]
        steps = [r + target for r in rest] if isinstance(target, int) else target
        return struct.pack("<IH6h", session, duration_ms, *steps)

    def idle(self) -> None:
        """Start a rule with a new session, in IDLE."""
        self.hello(SESSION)
        self.must(Reason.ok, CLEAR, OURS, "to begin with")
        status = self.status()
        self.expect(status.state == State.idle and not status.attached, f"after CLEAR {stands(status)}")

    def armed(self, action: int = Action.relax, watchdog_ms: int = 250) -> None:
        """Start a rule armed, with pulses on all servos, at rest."""
        self.idle()
        self.must(Reason.ok, ARM, self.arm(action, watchdog_ms))
        self.started()

    def started(self) -> None:
        """Wait after ARM until all servos have pulses and are at rest."""
        until = self._transport.now() + CONSTANTS["start_max_ms"] * 1e-3 + SLACK
        while (status := self.status()).attached != 0x3F or status.moving:
            self.expect(status.state == State.armed, f"while servos start: {stands(status)}, must be armed")
            text = f"{CONSTANTS['start_max_ms']} ms after ARM servos {status.attached:06b} have pulses, moving {status.moving}"
            self.expect(self._transport.now() < until, text)
            self.live(0.03)

    def moved(self, target: int = 2000) -> None:
        """Move all servos to `target` [1e-4 rad] from rest and check the pose."""
        self.must(Reason.ok, MOVE, self.move(target))
        self.live(0.4 + SLACK)
        status = self.status()
        wanted = tuple(servo.rest_urad // 100 + target for servo in self.limits)
        off = max(abs(is_at - to) for is_at, to in zip(status.servo, wanted, strict=True))
        self.expect(off <= 1 and not status.moving, f"after a move {status.servo}, must be {wanted} [1e-4 rad]")

    def faults(self) -> list[int]:
        """Codes of the FAULT messages heard since the last call."""
        codes = [message.payload[0] for message in self.unasked if message.kind == FAULT and len(message.payload) == 6]
        self.unasked.clear()
        return codes


def _told(message: Message) -> str:
    return f"message 0x{message.kind:02x} with {len(message.payload)} bytes"


def stands(status: Status) -> str:
    return f"{name_of(State, status.state)}, fault {name_of(Fault, status.fault)}, servos {status.attached:06b}"
