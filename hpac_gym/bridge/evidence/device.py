"""A device under test: requests sent with the oracle's codec, and checks of the answers."""

import struct
from dataclasses import dataclass

from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.bridge.protocol import CONSTANTS, Action, Fault, Reason, State, name_of
from hpac_gym.bridge.transport import Transport
from hpac_gym.model import Hand

_NAMES = {
    getattr(wire, name): name
    for name in ("HELLO", "ARM", "MOVE", "HEARTBEAT", "ESTOP", "CLEAR", "STATUS")
}
_ANSWERS = {wire.HELLO: wire.DEVICE_HELLO, wire.STATUS: wire.DEVICE_STATUS}
SLACK = 0.15
"""Tolerance for the delays of device and line [s]."""
SILENCE = wire.Message(0, 0, 0, 0, b"")
"""No answer."""
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

    def __str__(self) -> str:
        return f"{name_of(State, self.state)}, fault {name_of(Fault, self.fault)}, servos {self.attached:06b}"


class Device:
    """The device under test: requests, answers and checks."""

    def __init__(self, transport: Transport, hand: Hand, patience: float) -> None:
        self.transport = transport
        self._reader = wire.Reader()
        self._patience = patience
        self._seq = 0
        self.limits = servo_limits(hand)
        self.rest = [servo.rest_urad // 100 for servo in self.limits]
        """Pose at rest, shape (6,) [1e-4 rad]."""
        self.hand = hand
        self.hash = 0
        self.tried = 0
        self.unasked: list[wire.Message] = []

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
        until = self.transport.now() + seconds
        while (left := until - self.transport.now()) > 0:
            self.unasked += self._reader.push(self.transport.read(left))

    def live(self, seconds: float) -> None:
        """Wait as an active controller, sending heartbeats."""
        until = self.transport.now() + seconds
        while (left := until - self.transport.now()) > 0:
            self.send(wire.HEARTBEAT, OURS, wire.NO_ACK)
            self.listen(min(left, 0.03))

    def send(
        self,
        kind: int,
        payload: bytes = b"",
        flags: int = 0,
        version: int = wire.VERSION,
        seq: int | None = None,
    ) -> int:
        """Send a frame; returns its sequence number."""
        self._seq = self._seq % 0xFFFF + 1
        seq = self._seq if seq is None else seq
        self.transport.write(wire.frame(kind, seq, payload, flags, version))
        return seq

    def ask(self, kind: int, payload: bytes = b"", **how: int) -> wire.Message:
        """Send a frame, `how` as in `send`, and return the first answer with its sequence number,
        or `SILENCE`.
        """
        seq = self.send(kind, payload, **how)
        until = self.transport.now() + self._patience
        while (left := until - self.transport.now()) > 0:
            heard = self._reader.push(self.transport.read(left))
            answers = [
                message
                for message in heard
                if message.seq == seq and message.kind in (wire.ACK, _ANSWERS.get(kind))
            ]
            self.unasked += [message for message in heard if message not in answers]
            if answers:
                self.unasked += answers[1:]
                return answers[0]
        return SILENCE

    def refusal(self, kind: int, payload: bytes = b"", **how: int) -> tuple[int, int] | None:
        """Send a frame and return reason and servo of the answering ACK; None without one."""
        answer = self.ask(kind, payload, **how)
        if answer.kind != wire.ACK or len(answer.payload) != 4:
            return None
        return answer.payload[1], answer.payload[2]

    def must(
        self, reason: Reason, kind: int, payload: bytes = b"", text: str = "", **how: int
    ) -> None:
        """Require that the device answers this message with an ACK of this reason."""
        got = self.refusal(kind, payload, **how)
        told = "no ACK" if got is None else name_of(Reason, got[0])
        self.expect(
            got is not None and got[0] == reason,
            f"{_NAMES.get(kind, kind)} {text}: {told}, must be {reason.name}",
        )

    def hello(self, nonce: int) -> Hello:
        """Send HELLO and return the answer."""
        answer = self.ask(wire.HELLO, struct.pack("<I", nonce))
        self.expect(answer is not SILENCE, "HELLO got no answer")
        self.expect(
            answer.kind == wire.DEVICE_HELLO and len(answer.payload) == 30,
            f"HELLO answered by {_told(answer)}",
        )
        numbers = struct.unpack("<I3xI6hBH3xB", answer.payload)
        session, limits, *trims, reversed_mask, watchdog_ms, state = numbers
        return Hello(session, limits, tuple(trims), reversed_mask, watchdog_ms, state)

    def status(self, period_ms: int = 0) -> Status:
        """Request STATUS and return the answer."""
        answer = self.ask(wire.STATUS, struct.pack("<H", period_ms))
        self.expect(answer is not SILENCE, "STATUS got no answer")
        self.expect(
            answer.kind == wire.DEVICE_STATUS and len(answer.payload) == 50,
            f"STATUS answered by {_told(answer)}",
        )
        numbers = struct.unpack("<4x4B6h10xHI5H2xH", answer.payload)
        state, fault, attached, moving = numbers[:4]
        return Status(state, fault, attached, moving, numbers[4:10], *numbers[10:])

    def must_be(
        self, state: State, when: str, fault: Fault | None = None, powered: bool | None = None
    ) -> Status:
        """Require a state in STATUS, and, unless None, this fault and any or no pulses; returns the
        STATUS.
        """
        status = self.status()
        kept = (
            status.state == state
            and fault in (None, status.fault)
            and powered in (None, status.attached > 0)
        )
        wanted = (
            state.name
            + (f" ({fault.name})" if fault is not None else "")
            + (" without pulses" if powered is False else "")
        )
        self.expect(kept, f"{when} {status}, must be {wanted}")
        return status

    def arm(
        self,
        action: int = Action.relax,
        watchdog_ms: int = 250,
        hash_: int | None = None,
        session: int = SESSION,
    ) -> bytes:
        """Payload of an ARM."""
        return struct.pack(
            "<IIHB", session, self.hash if hash_ is None else hash_, watchdog_ms, action
        )

    def move(
        self, target: int | list[int], duration_ms: int = 400, session: int = SESSION
    ) -> bytes:
        """Payload of a MOVE to `target` above each servo's rest [1e-4 rad]."""
        steps = [rest + target for rest in self.rest] if isinstance(target, int) else target
        return struct.pack("<IH6h", session, duration_ms, *steps)

    def idle(self) -> None:
        """Start a rule with a new session, in IDLE."""
        self.hello(SESSION)
        self.must(Reason.ok, wire.CLEAR, OURS, "to begin with")
        self.must_be(State.idle, "after CLEAR", powered=False)

    def armed(self, action: int = Action.relax, watchdog_ms: int = 250) -> None:
        """Start a rule armed, with pulses on all servos, at rest."""
        self.idle()
        self.must(Reason.ok, wire.ARM, self.arm(action, watchdog_ms))
        self.started()

    def started(self) -> None:
        """Wait after ARM until all servos have pulses and are at rest."""
        until = self.transport.now() + CONSTANTS["start_max_ms"] * 1e-3 + SLACK
        while (status := self.status()).attached != 0x3F or status.moving:
            self.expect(status.state == State.armed, f"while servos start: {status}, must be armed")
            text = f"{CONSTANTS['start_max_ms']} ms after ARM servos {status.attached:06b} have pulses, moving {status.moving}"
            self.expect(self.transport.now() < until, text)
            self.live(0.03)

    def moved(self, target: int = 2000) -> None:
        """Move all servos to `target` [1e-4 rad] from rest and check the pose."""
        self.must(Reason.ok, wire.MOVE, self.move(target))
        self.live(0.4 + SLACK)
        status = self.status()
        wanted = tuple(rest + target for rest in self.rest)
        off = max(abs(is_at - to) for is_at, to in zip(status.servo, wanted, strict=True))
        self.expect(
            off <= 1 and not status.moving,
            f"after a move {status.servo}, must be {wanted} [1e-4 rad]",
        )

    def must_have_told(self, fault: Fault) -> None:
        """Require that exactly one FAULT message, of this fault, is among `unasked`, and clear
        them.
        """
        codes = [
            message.payload[0]
            for message in self.unasked
            if message.kind == wire.FAULT and len(message.payload) == 6
        ]
        self.unasked.clear()
        self.expect(codes == [fault], f"FAULT messages {codes}, must be one of {fault.name}")


def _told(message: wire.Message) -> str:
    return f"message 0x{message.kind:02x} with {len(message.payload)} bytes"
