"""Questions and answers over one transport: sequence numbers, repeats, time-outs, statistics."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from hpac_gym.bridge.errors import LinkTimeout
from hpac_gym.bridge.frame import Frame, FrameSplitter, encode
from hpac_gym.bridge.protocol import MESSAGES
from hpac_gym.bridge.statistics import LinkStatistics
from hpac_gym.bridge.transport import Transport
from hpac_gym.bridge.wire_log import WireLog

_ANSWERS = {"hello": "device_hello", "status": "device_status"}
"""What answers a message that is carried out; ACK for all others, and for every refusal."""

_SEQ_MAX = 0xFFFF


@dataclass(slots=True)
class _Open:
    name: str
    sent_at: float
    repeated: bool = False
    answer: Frame | None = None


class Exchange:
    """One connection's conversation.

    Args:
        on_frame: called with every intact frame from the hand, answers included.
    """

    def __init__(
        self,
        transport: Transport,
        statistics: LinkStatistics,
        on_frame: Callable[[Frame], None],
        log: WireLog | None = None,
    ) -> None:
        self.transport = transport
        self.splitter = FrameSplitter()
        self._statistics = statistics
        self._on_frame = on_frame
        self._log = log
        self._seq = 0
        self._open: dict[int, _Open] = {}

    def request(
        self,
        name: str,
        fields: Mapping[str, int | tuple[int, ...]] | None = None,
        flags: int = 0,
        timeout: float = 0.1,
        attempts: int = 3,
    ) -> Frame:
        """Send a message and return its answer: an ACK, or what answers this message.

        The same frame is sent up to `attempts` times, `timeout` [s] apart; the hand carries a repeat out only once.

        Raises:
            LinkTimeout: No answer.
            PortError: The port has gone.
        """
        frame = self._frame(name, fields, flags)
        waiting = self._open[frame.seq] = _Open(name, self.transport.now())
        try:
            for attempt in range(attempts):
                waiting.repeated = attempt > 0
                self._statistics.retried += waiting.repeated
                self._write(frame)
                self._receive_until(self.transport.now() + timeout, waiting)
                if waiting.answer is not None:
                    return waiting.answer
        finally:
            del self._open[frame.seq]
        self._statistics.timeouts += 1
        raise LinkTimeout(f"no answer to {name}: {attempts} times, {timeout:g} s each")

    def send(self, name: str, fields: Mapping[str, int | tuple[int, ...]] | None = None, flags: int = 0) -> None:
        """Send a message that asks for no answer.

        Raises:
            PortError: The port has gone.
        """
        self._write(self._frame(name, fields, flags))

    def listen(self, seconds: float) -> None:
        """Let time pass, taking in what the hand says.

        Raises:
            PortError: The port has gone.
        """
        self._receive_until(self.transport.now() + seconds, None)

    def _frame(self, name: str, fields: Mapping[str, int | tuple[int, ...]] | None, flags: int) -> Frame:
        self._seq = self._seq % _SEQ_MAX + 1  # 0 is left to what the hand says unasked
        return Frame(name, self._seq, flags, fields or {})

    def _write(self, frame: Frame) -> None:
        data = encode(frame)
        if self._log:
            self._log.record(self.transport.now(), "sent", data[1:-1], frame)
        self._statistics.sent += 1
        self.transport.write(data)

    def _receive_until(self, deadline: float, waiting: _Open | None) -> None:
        while waiting is None or waiting.answer is None:
            left = deadline - self.transport.now()
            data = self.transport.read(max(left, 0.0))
            for encoded, frame in self.splitter.push(data):
                self._take_in(encoded, frame)
            if left <= 0:
                return

    def _take_in(self, encoded: bytes, frame: Frame) -> None:
        self._statistics.received += 1
        round_trip = None
        waiting = self._open.get(frame.seq)
        if waiting is not None and waiting.answer is None and _is_answer(frame, waiting.name):
            waiting.answer = frame
            round_trip = self.transport.now() - waiting.sent_at
            if not waiting.repeated:
                self._statistics.round_trips.append(round_trip)
        if self._log:
            self._log.record(self.transport.now(), "received", encoded, frame, round_trip)
        self._on_frame(frame)


def _is_answer(frame: Frame, name: str) -> bool:
    if frame.name == "ack":
        return frame.fields["acked"] == MESSAGES[name].code
    return frame.name == _ANSWERS.get(name)
