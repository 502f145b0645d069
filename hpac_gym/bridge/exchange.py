"""Requests and answers over one transport: sequence numbers, repeats, time-outs, counters, the log
of every frame.
"""

import json
import secrets
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from weakref import WeakMethod

import numpy as np

from hpac_gym.bridge.errors import LinkTimeout, LogWarning, PortError, tell
from hpac_gym.bridge.protocol import (
    MESSAGE_BY_CODE,
    MESSAGES,
    Fields,
    Frame,
    FrameSplitter,
    Reason,
    State,
    encode,
    name_of,
)
from hpac_gym.bridge.reports import KnownState
from hpac_gym.bridge.transport import Transport
from hpac_gym.output import Lines

_ANSWERS = {"hello": "device_hello", "status": "device_status"}
"""Answers to executed messages other than ACK, which answers all others and every refusal."""

_SEQ_MAX = 0xFFFF
_SEQ_LEAD = 0x4000
"""By how much the number of another message may exceed that of the last MOVE: a hand refuses the next
one 0x8000 after the last that it accepted.
"""
_ROUND_TRIPS_KEPT = 100_000
_READ_MAX = 60.0
"""Longest time of one read [s]: a port cannot wait for ever."""


@dataclass(slots=True)
class LinkStatistics:
    """Counters of one `HandLink`, over all of its connections."""

    sent: int = 0
    """Frames written, including repeats."""
    retried: int = 0
    """Repeated frames, after a time-out."""
    rejected: int = 0
    """Frames that the hand refused."""
    received: int = 0
    """Intact frames from the hand."""
    round_trips: deque[float] = field(
        default_factory=lambda: deque(maxlen=_ROUND_TRIPS_KEPT), repr=False
    )
    """Times from writing a frame to its answer, without repeated frames [s]."""

    def round_trip(self, percentile: float) -> float:
        """A percentile of the round trips [s]; NaN before the first."""
        return (
            float(np.percentile(self.round_trips, percentile)) if self.round_trips else float("nan")
        )


class WireLog(Lines):
    """Logs all frames, one JSON object per line; a context manager.

    Each line has `t` [s], `direction` (`sent` or `received`), `hex` (the frame between its zeros),
    `message`, `seq`, `flags` and `fields` (raw integers, units in docs/wire.md). An ACK's line also
    has `acked`, `reason` and `state` by name, and every answer `round_trip` [s]. If the log fails,
    the link warns once and continues without it.

    Raises:
        OutputError: The file cannot be written.
    """

    def record(
        self,
        time: float,
        direction: str,
        encoded: bytes,
        frame: Frame,
        round_trip: float | None = None,
    ) -> None:
        """Write one line; `round_trip` [s] if the frame is an answer."""
        line = {
            "t": round(time, 6),
            "direction": direction,
            "hex": encoded.hex(),
            "message": frame.name,
            "seq": frame.seq,
            "flags": frame.flags,
            "fields": dict(frame.fields),
        }
        if frame.name == "ack":
            code = frame.number("acked")
            line["acked"] = (
                MESSAGE_BY_CODE[code].name if code in MESSAGE_BY_CODE else f"unknown_{code}"
            )
            line["reason"] = name_of(Reason, frame.number("reason"))
            line["state"] = name_of(State, frame.number("state"))
        if round_trip is not None:
            line["round_trip"] = round(round_trip, 7)
        self.append(json.dumps(line))


@dataclass(slots=True)
class _Open:
    name: str
    sent_at: float
    repeated: bool = False
    answer: Frame | None = None


class Exchange:
    """The exchange of frames over one connection, in a session of its own.

    Args:
        check: called at every step of a call; raises `StoppedError` if the call must end.

    Attributes:
        known: the state of the hand, updated by every frame.
        statistics: the counters that it updates.
        session: nonce of this controller's HELLO, which its other messages carry.
        refused: a message that was sent without waiting for an answer and that was refused, and its
            refusal, for the next call to raise; or None.
        host_frames: number of received frames of host message types, which indicate an echo.
        on_ack: weak reference to a method, called with every ACK for which nobody waits; or None.
    """

    def __init__(
        self,
        transport: Transport,
        statistics: LinkStatistics,
        check: Callable[[], None] = lambda: None,
        log: WireLog | None = None,
    ) -> None:
        self.transport = transport
        self.splitter = FrameSplitter()
        self.session = 1 + secrets.randbelow(0xFFFFFFFF)
        self.refused: tuple[Frame, Frame] | None = None
        self.host_frames = 0
        self.on_ack: WeakMethod[Callable[[Frame], None]] | None = None
        self.statistics = statistics
        self.known = KnownState()
        self._check = check
        self._log = log
        self._seq = 0
        self._moved = 0
        self._open: dict[int, _Open] = {}

    def request(
        self,
        name: str,
        fields: Fields | None = None,
        flags: int = 0,
        timeout: float = 0.1,
        attempts: int = 3,
        late: bool = False,
    ) -> Frame:
        """Send a message and return its answer: an ACK, or the specific answer to this message.

        The same frame is sent up to `attempts` times, `timeout` [s] apart; the hand executes it
        only once. What a `late` answer confirms is known also after these, if no ARM follows.

        Raises:
            LinkTimeout: No answer.
            PortError: The port is gone.
            StoppedError: See `check`.
        """
        self._check()
        frame = self._frame(name, fields, flags)
        waiting = self._open[frame.seq] = _Open(name, self.transport.now())
        try:
            for attempt in range(attempts):
                waiting.repeated = attempt > 0
                self.statistics.retried += waiting.repeated
                self._write(frame)
                self._receive_until(self.transport.now() + timeout, waiting)
                if waiting.answer is not None:
                    return waiting.answer
        finally:
            if not late:
                del self._open[frame.seq]
        raise LinkTimeout(f"no answer to {name}: {attempts} times, {timeout:g} s each")

    def send(self, name: str, fields: Fields | None = None) -> int:
        """Send a message without waiting for an answer; returns its number.

        Raises:
            PortError: The port is gone.
        """
        frame = self._frame(name, fields)
        self._write(frame)
        return frame.seq

    def listen(self, seconds: float) -> None:
        """Receive frames from the hand for `seconds`.

        Raises:
            PortError: The port is gone.
            StoppedError: See `check`.
        """
        self._receive_until(self.transport.now() + seconds, None)

    def _frame(self, name: str, fields: Fields | None, flags: int = 0) -> Frame:
        number = self._seq % _SEQ_MAX + 1  # 0 is reserved for unsolicited messages of the hand
        if name == "move":
            self._moved = number
        elif (number - self._moved) % (_SEQ_MAX + 1) > _SEQ_LEAD:
            number = self._moved % _SEQ_MAX + 1
        self._seq = number
        usual = {"session": self.session, "nonce": self.session, "period_ms": 0}
        ours = {part.name: usual[part.name] for part in MESSAGES[name].fields if part.name in usual}
        return Frame(name, self._seq, flags, ours | dict(fields or {}))

    def _write(self, frame: Frame) -> None:
        """Write a frame to the port before counting and logging it, so that nothing delays it."""
        data = encode(frame)
        if frame.name == "arm":  # from now on, even if this fails
            self.known.may_have_power = True
        try:
            self.transport.write(data)
        except PortError:
            self._check()
            raise
        self.statistics.sent += 1
        self._record("sent", data[1:-1], frame)

    def _receive_until(self, deadline: float, waiting: _Open | None) -> None:
        while waiting is None or waiting.answer is None:
            self._check()
            left = deadline - self.transport.now()
            try:
                data = self.transport.read(min(max(left, 0.0), _READ_MAX))
            except PortError:
                # a read in a signal handler makes this one fail as if the port were gone
                self._check()
                raise
            for encoded, frame in self.splitter.push(data):
                self._take_in(encoded, frame)
            if left <= 0:
                break
        self._check()

    def _take_in(self, encoded: bytes, frame: Frame) -> None:
        if MESSAGES[frame.name].from_host:
            self.host_frames += 1
            return
        self.statistics.received += 1
        round_trip = answered = None
        waiting = self._open.get(frame.seq)
        if waiting is not None and waiting.answer is None and _is_answer(frame, waiting.name):
            waiting.answer = frame
            answered = waiting.name
            round_trip = self.transport.now() - waiting.sent_at
            if not waiting.repeated:
                self.statistics.round_trips.append(round_trip)
        elif frame.name == "ack":
            on_ack = self.on_ack and self.on_ack()
            if on_ack:
                on_ack(frame)
        self.known.take_in(frame, answered)
        self._record("received", encoded, frame, round_trip)

    def _record(
        self, direction: str, encoded: bytes, frame: Frame, round_trip: float | None = None
    ) -> None:
        if self._log is None:
            return
        try:
            self._log.record(self.transport.now(), direction, encoded, frame, round_trip)
        except Exception as error:  # a failing log must not affect the link
            self._log = None
            tell(
                LogWarning(
                    f"the wire log cannot be written, the link continues without it: {error}"
                )
            )


def _is_answer(frame: Frame, name: str) -> bool:
    if frame.name == "ack":
        return frame.number("acked") == MESSAGES[name].code
    return frame.name == _ANSWERS.get(name)
