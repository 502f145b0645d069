"""Commands at a fixed rate that survive lost, late and refused frames.

A hand refuses a MOVE that is further from its pose than its rate limit allows. After a lost frame a
stream that continues from the pose it *sent* is therefore refused for ever. This one continues from
the poses that the hand may *have*: the last one that it acknowledged, and all that were sent since.
A command stays within reach of each of them, so none is refused, whichever arrived. Every command is
followed by a request of STATUS, whose answer says which one the hand has, even if its ACK was lost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol
from weakref import WeakMethod

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.bridge.errors import FrameError, LinkTimeout
from hpac_gym.bridge.exchange import Exchange
from hpac_gym.bridge.frame import Fields, Frame
from hpac_gym.bridge.protocol import ANGLE_UNIT, Reason
from hpac_gym.bridge.reports import HandStatus
from hpac_gym.model import SERVOS
from hpac_gym.model.checks import Array, as_finite_vector

MARGIN = 0.9
"""Share of the rate limit that a stream uses: at 20 Hz a frame may come 5 ms early."""
LATE = 0.002
"""A command that is sent this much after its time is counted as late [s]."""
PATIENCE = 1.0
"""Longest time without an answer to any command [s]; the hand's own watchdog acts before."""
_PERIODS = (0.02, 1.0)
_SLOWER = 0.8
"""Share of its speed that a stream keeps after a refusal for heat, until the next STATUS."""


@dataclass(slots=True)
class StreamCounts:
    """What became of the commands of a stream."""

    sent: int = 0
    acknowledged: int = 0
    lost: int = 0
    """Commands that were lost, or all answers to them."""
    late: int = 0
    """Commands sent more than `LATE` after their time."""
    skipped: int = 0
    """Periods in which no command was sent, since the program was busy."""
    refused: int = 0
    hot: int = 0
    """Refusals because a servo is hot, which also slow the stream down."""
    limited: int = 0
    """Commands that did not reach their target within the period."""
    worst_delay: float = 0.0
    """Longest time after its own at which a command was sent [s]."""


class Link(Protocol):
    """What a stream needs of a `HandLink`."""

    @property
    def exchange(self) -> Exchange: ...
    @property
    def last_status(self) -> HandStatus | None: ...
    @property
    def rate_limit(self) -> Array: ...
    def status(self) -> HandStatus: ...
    def within_table(self, servo: Array) -> Array: ...
    def send_unanswered(self, name: str, fields: Fields) -> int: ...
    def listen(self, seconds: float, what: str) -> None: ...


class Stream:
    """Commands to an armed hand at a fixed rate, on an absolute clock.

    ```python
    with HandLink(port) as link:
        link.arm(watchdog=0.5)
        stream = link.stream(period=0.05)
        for target in targets:
            servo = stream.send(target)   # waits for its time; the angles that were sent
    ```
    Pauses of more than the watchdog's period need `HandLink.sleep`, and a new stream afterwards.

    Attributes:
        counts: what became of the commands.
        period: time between two commands [s].
    """

    def __init__(self, link: Link, period: float, margin: float) -> None:
        if not _PERIODS[0] <= period <= _PERIODS[1]:
            raise FrameError(f"period = {period} s, allowed {_PERIODS[0]} to {_PERIODS[1]} s")
        if not 0 < margin <= 1:
            raise FrameError(f"margin = {margin}, allowed above 0 to 1")
        self.period = period
        self.counts = StreamCounts()
        self._link = link
        self._margin = margin
        status = link.status()
        # The poses that the hand may have, by the number of the command that led there.
        self._poses: dict[int, Array] = {0: status.servo}
        self._share = status.rate_share
        self._status = link.last_status
        # The last command before a request of STATUS, by the request's number.
        self._asked: dict[int, int] = {}
        self._exchange = link.exchange
        # Weak: a forgotten link, which the stream holds, must end.
        self._exchange.on_ack = WeakMethod(self._answered)
        self._sent_at = -np.inf
        self._waited = False
        self.begin()

    def send(self, target: ArrayLike) -> Array:
        """Wait for the next period, and send the command that leads towards a target.

        Args:
            target: servo angles, shape (6,) [rad].

        Returns:
            The angles that were sent: within the servos' range, and within reach of every pose
            that the hand may have; shape (6,) [rad].

        Raises:
            ShapeError: Another shape, or NaN.
            FaultError: A fault has latched. RejectedError: another program has taken the hand over.
            LinkTimeout, PortError: No answer to any command for a second; the port is gone.
        """
        target = self._link.within_table(as_finite_vector(target, len(SERVOS), "target"))
        if not self._waited:
            self.wait()
        self._waited = False
        poses = np.stack(list(self._poses.values()))
        # What is left of the last ramp has to be gone through, too.
        since = min(self._exchange.transport.now() - self._sent_at, self.period)
        reach = self._margin * self._share * since * self._link.rate_limit
        low = poses.max(axis=0) - reach
        high = poses.min(axis=0) + reach
        # All six arrive together, as in every move: the way is shortened, not bent.
        start = np.where(low > high, (low + high) / 2, np.clip(poses[-1], low, high))
        way = target - start
        room = np.where(way > 0, high - start, start - low).clip(min=0.0)
        share = min(1.0, *(room / np.maximum(np.abs(way), 1e-12)))
        steps = np.rint((start + share * way) / ANGLE_UNIT).astype(int)
        servo: Array = steps * ANGLE_UNIT
        self.counts.limited += bool((np.abs(servo - target) > ANGLE_UNIT).any())
        duration_ms = round(1e3 * self.period)
        fields: Fields = {"duration_ms": duration_ms, "servo": tuple(steps.tolist())}
        number = self._link.send_unanswered("move", fields)
        self._poses[number] = servo
        self._asked[self._exchange.send("status", {"period_ms": 0})] = number
        self._sent_at = self._exchange.transport.now()
        self.counts.sent += 1
        return servo

    def begin(self) -> None:
        """The first command is due now: for programs that wait, with `HandLink.sleep`, between the
        making of a stream and its first command.
        """
        self._due = self._heard_at = self._exchange.transport.now()

    def close(self) -> None:
        """End the stream: later moves of the link are answered as usual. A stream that is not
        closed ends with its link.
        """
        self._exchange.on_ack = None
        self._link.status()

    def wait(self) -> None:
        """Wait for the time of the next command, which the next `send` then does not wait for: for
        programs that look at the world as late as they can. Errors as of `send`.
        """
        self._waited = True
        now = self._exchange.transport.now
        self._link.listen(max(self._due - now(), 0.0), "move")
        if now() - self._heard_at > PATIENCE:
            raise LinkTimeout(f"no answer to a streamed move for {PATIENCE:g} s")
        status = self._link.last_status
        if status is not None and status is not self._status:
            self._status = status
            self._told(status)
        delay = now() - self._due
        self.counts.worst_delay = max(self.counts.worst_delay, delay)
        self.counts.late += delay > LATE
        if (missed := int(delay / self.period)) > 0:  # no burst: the hand would refuse it
            self.counts.skipped += missed
            self._due += missed * self.period
        self._due += self.period

    def _told(self, status: HandStatus) -> None:
        """Take note of a STATUS: the hand has one of the commands that came before its request, and
        none of the others.
        """
        self._share = status.rate_share
        last = self._asked.pop(status.number, None)
        if last in self._poses:
            first = next(iter(self._poses))
            self._heard_at = self._exchange.transport.now()
            self._has(status.last_seq if status.last_seq in self._poses else first, last)

    def _has(self, accepted: int, last: int) -> None:
        """The hand has the pose of one command, and no other one of those up to `last`."""
        first, *others = list(self._poses)
        gone = [first, *others[: others.index(last) + 1]] if last != first else [first]
        for number in gone:
            if number != accepted:
                self.counts.lost += number != first
                del self._poses[number]

    def _answered(self, sent: Frame, ack: Frame) -> None:
        """Take note of an answer: the hand has this pose now, or does not."""
        if sent.name != "move" or sent.seq not in self._poses:
            return
        self._heard_at = self._exchange.transport.now()
        reason = ack.number("reason")
        if reason not in (Reason.ok, Reason.rate, Reason.hot):
            self._exchange.refused = sent, ack
        if reason == Reason.ok:
            self.counts.acknowledged += 1
            self._has(sent.seq, sent.seq)
            return
        del self._poses[sent.seq]
        self.counts.refused += 1
        if reason == Reason.hot:
            self.counts.hot += 1
            self._share *= _SLOWER
