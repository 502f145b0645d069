"""A device under test: requests sent with the oracle's codec, and checks of the answers."""

import re
import struct
from collections import namedtuple
from contextlib import suppress
from threading import current_thread

from hpac_gym.bridge.errors import BridgeError
from hpac_gym.bridge.evidence import codec as wire
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.bridge.protocol import CONSTANTS, Action, Fault, Reason, State, name_of
from hpac_gym.bridge.transport import Transport
from hpac_gym.model import Hand

_NAMES = {
    getattr(wire, name): name
    for name in ("HELLO", "ARM", "MOVE", "HEARTBEAT", "ESTOP", "CLEAR", "STATUS")
}
_LEADS_TO = {
    wire.ARM: State.armed,
    wire.MOVE: State.armed,
    wire.CLEAR: State.idle,
    wire.ESTOP: State.fault,
}
_OF_ONE_SERVO = (Reason.angle, Reason.rate, Reason.hot)
NO_SERVO = 255
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


Hello = namedtuple("Hello", "session limits_hash trim_ns reversed_mask watchdog_ms reset state")
Status = namedtuple(
    "Status",
    "uptime_ms state fault attached moving servo heat_percent rate_permille last_seq accepted refused"
    " bad_crc bad_frame bad_version overrun trips",
)
"""The integers of DEVICE_HELLO and DEVICE_STATUS, in their order; tuples of six by servo."""


class Talk:
    """Frames to and from a device, whose form is judged.

    Args:
        transport: to the device.
        patience: time-out of one answer [s].

    Attributes:
        unasked: messages that answered nothing.
    """

    def __init__(self, transport: Transport, patience: float) -> None:
        self.transport = transport
        self.unasked: list[wire.Message] = []
        self._reader = wire.Reader()
        self._last_bytes = b""
        self._heard: list[wire.Message] = []
        self._patience = patience
        self._seq = 0

    def _hear(self, seconds: float) -> None:
        """Receive messages for at most `seconds`.

        Raises:
            BrokenRule: One of them does not have the form of the hand's frames.
        """
        data = self.transport.read(seconds)
        self._heard += (heard := self._reader.push(data))
        joint = self._last_bytes + data
        self._last_bytes = joint[-2:]
        if re.search(rb"[^\0]\0[^\0]", joint):
            raise BrokenRule("one zero byte between two frames, must be two")
        for message in heard:
            if message.version != wire.VERSION or message.flags:
                raise BrokenRule(
                    f"{_told(message)} has version {message.version} and flags {message.flags:#x},"
                    f" must be {wire.VERSION} and 0"
                )

    def listen(self, seconds: float) -> None:
        """Receive messages for `seconds` and append them to `unasked`."""
        until = self.transport.now() + seconds
        while (left := until - self.transport.now()) > 0:
            self._hear(left)
        self.unasked += self._heard
        self._heard.clear()

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
        or `SILENCE`. What comes before it is appended to `unasked`, what comes after it is heard
        next.

        Raises:
            BrokenRule: The answer is an ACK with a field that does not fit.
        """
        seq = self.send(kind, payload, **how)
        until = self.transport.now() + self._patience
        while (left := until - self.transport.now()) > 0:
            self._hear(left)
            while self._heard:
                message = self._heard.pop(0)
                if message.seq == seq and message.kind == _ANSWERS.get(kind):
                    return message
                if message.seq == seq and message.kind == wire.ACK:
                    if len(message.payload) == 4:
                        _judge_ack(kind, message.payload)
                    return message
                self.unasked.append(message)
        return SILENCE

    def refusal(self, kind: int, payload: bytes = b"", **how: int) -> tuple[int, int] | None:
        """Send a frame and return reason and servo of the answering ACK; None without one."""
        answer = self.ask(kind, payload, **how)
        if answer.kind != wire.ACK or len(answer.payload) != 4:
            return None
        return answer.payload[1], answer.payload[2]


class Device(Talk):
    """The device under test: requests, answers and checks."""

    def __init__(self, transport: Transport, hand: Hand, patience: float) -> None:
        super().__init__(transport, patience)
        self.limits = servo_limits(hand)
        self.rest = [servo.rest_urad // 100 for servo in self.limits]
        """Pose at rest, shape (6,) [1e-4 rad]."""
        rate = min(servo.rate_urad_s for servo in self.limits) * 1e-6
        self.pace_ms = min(max(400, round(320 / rate)), CONSTANTS["move_max_ms"])
        """Duration of a move by at most 0.25 rad, which the slowest servo can follow [ms]."""
        self.relax_rate = rate * CONSTANTS["relax_permille"] * 1e-3
        """Speed of the slowest servo in a relax [rad/s]."""
        self.hand = hand
        self.hash = 0
        self.tried = 0
        self.thread = current_thread()

    def end(self) -> None:
        """Leave the device without pulses and close the port."""
        with suppress(BridgeError):
            self.send(wire.CLEAR, OURS)
            self.send(wire.ESTOP)
        self.transport.close()

    def expect(self, kept: bool, what: str) -> None:
        """Check the current rule and count the check.

        Raises:
            BrokenRule: The rule is violated.
        """
        self.tried += 1
        if not kept:
            raise BrokenRule(what)

    def live(self, seconds: float) -> None:
        """Wait as an active controller, sending heartbeats."""
        until = self.transport.now() + seconds
        while (left := until - self.transport.now()) > 0:
            self.send(wire.HEARTBEAT, OURS, wire.NO_ACK)
            self.listen(min(left, 0.03))

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

    def _answer(self, kind: int, payload: bytes, layout: str) -> tuple[int, ...]:
        """Send HELLO or STATUS and return the integers of its answer, whose layout is given."""
        answer = self.ask(kind, payload)
        self.expect(answer is not SILENCE, f"{_NAMES[kind]} got no answer")
        fits = len(answer.payload) == struct.calcsize(layout)
        answered = answer.kind == _ANSWERS[kind] and fits
        self.expect(answered, f"{_NAMES[kind]} answered by {_told(answer)}")
        return struct.unpack(layout, answer.payload)

    def hello(self, nonce: int) -> Hello:
        """Send HELLO and return the answer."""
        numbers = self._answer(wire.HELLO, struct.pack("<I", nonce), "<I3xI6hBHB2xB")
        return Hello._make((*numbers[:2], numbers[2:8], *numbers[8:]))

    def status(self, period_ms: int = 0) -> Status:
        """Request STATUS and return the answer."""
        numbers = self._answer(wire.STATUS, struct.pack("<H", period_ms), "<I4B6h6BH2xHI5H2xH")
        return Status._make((*numbers[:5], numbers[5:11], numbers[11:17], *numbers[17:]))

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
        self.expect(kept, f"{when} {_told_state(status)}, must be {wanted}")
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
        self, target: int | list[int], duration_ms: int | None = None, session: int = SESSION
    ) -> bytes:
        """Payload of a MOVE to `target` above each servo's rest [1e-4 rad], in `pace_ms` without a
        duration.
        """
        steps = [rest + target for rest in self.rest] if isinstance(target, int) else target
        duration_ms = self.pace_ms if duration_ms is None else duration_ms
        return struct.pack("<IH6h", session, duration_ms, *steps)

    def arrive(self) -> None:
        """Wait as an active controller until a move of `pace_ms` has ended."""
        self.live(self.pace_ms * 1e-3 + SLACK)

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
            self.expect(
                status.state == State.armed,
                f"while servos start: {_told_state(status)}, must be armed",
            )
            self.expect(
                self.transport.now() < until,
                f"{CONSTANTS['start_max_ms']} ms after ARM servos {status.attached:06b} have pulses, moving {status.moving}",
            )
            self.live(0.03)

    def moved(self, target: int = 2000) -> None:
        """Move all servos to `target` [1e-4 rad] from rest and check the pose."""
        self.must(Reason.ok, wire.MOVE, self.move(target))
        self.arrive()
        status = self.status()
        wanted = tuple(rest + target for rest in self.rest)
        off = max(abs(is_at - to) for is_at, to in zip(status.servo, wanted, strict=True))
        self.expect(
            off <= 1 and not status.moving,
            f"after a move {status.servo}, must be {wanted} [1e-4 rad]",
        )

    def must_have_told(self, fault: Fault) -> None:
        """Require that exactly one FAULT message, of this fault, of no servo and of number 0, is
        among `unasked`, and clear them.
        """
        told = [
            (message.payload[0], message.payload[1], message.seq)
            for message in self.unasked
            if message.kind == wire.FAULT and len(message.payload) == 6
        ]
        self.unasked.clear()
        self.expect(
            told == [(fault, NO_SERVO, 0)],
            f"FAULT messages {told}, must be one of {fault.name} ({fault}, {NO_SERVO}, 0)",
        )


def _judge_ack(kind: int, payload: bytes) -> None:
    acked, reason, servo, state = payload
    servo_fits = servo == NO_SERVO or reason in _OF_ONE_SERVO
    state_fits = reason != Reason.ok or state == _LEADS_TO.get(kind, state)
    if acked != kind or not servo_fits or not state_fits:
        raise BrokenRule(
            f"{_NAMES.get(kind, kind)} answered by ACK {name_of(Reason, reason)} of message"
            f" {acked}, servo {servo}, {name_of(State, state)}"
        )


def _told(message: wire.Message) -> str:
    return f"message 0x{message.kind:02x} with {len(message.payload)} bytes"


def _told_state(status: Status) -> str:
    fault = name_of(Fault, status.fault)
    return f"{name_of(State, status.state)}, fault {fault}, servos {status.attached:06b}"
