"""Commands at a fixed rate that survive lost, late and refused frames.

A hand refuses a MOVE that is further from its pose than its rate limit allows. After a lost frame a
stream that continues from the pose it *sent* is therefore refused for ever. This one continues from
the poses that the hand may *have*: on the last move that it acknowledged, or on one that was sent
since, each of them begun as early or as late as its frame may have come. A command stays within reach
of all of them, so none is refused, whichever arrived. Every command is followed by a request of
STATUS, whose answer says which move the hand makes and where it is.

A far target is approached by moves that are longer than the period, at nearly the full rate: the next
one only carries on, so that a frame that is early, late or lost costs no way."""

import math
from dataclasses import dataclass, replace
from weakref import WeakMethod

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.bridge.errors import FrameError, LinkTimeout
from hpac_gym.bridge.line import Line
from hpac_gym.bridge.protocol import ANGLE_UNIT, Fields, Frame, Reason
from hpac_gym.bridge.reports import HandStatus
from hpac_gym.model import SERVOS
from hpac_gym.model.checks import Array, as_finite_vector

EARLY = 0.005
"""Time by which a frame may come earlier, after another one, than it was sent after it [s]."""
AHEAD = 3
"""Longest move, in periods: a hand whose program hangs goes on for so long (chosen)."""
LATE = 0.002
"""A command that is sent this much after its time is counted as late [s]."""
PATIENCE = 1.0
"""Longest time without an answer to any command [s]; the hand's own watchdog acts before."""
_PERIODS = (0.02, 1.0)
_SLOWER = 0.8
"""Share of its speed that a stream keeps after a refusal for heat, until the next STATUS."""


@dataclass(frozen=True, slots=True)
class Ramp:
    """A move that the hand may make."""

    low: Array
    high: Array
    """Least and greatest angles at which it begins, shape (6,) [rad]."""
    to: Array
    """Where it leads, shape (6,) [rad]."""
    begun: float
    until: float
    """When it begins and ends if its frame is not late at all [s]."""
    fields: Fields
    """Of its frame."""

    def poses(self, now: float, early: float) -> Array:
        """Least and greatest angles at which a frame that is sent now meets the hand, when any frame
        may be late by up to `early` [s]; shape (2, 6) [rad].
        """
        since = now - self.begun + early * np.array([[-1.0], [1.0]])
        share = np.clip(since / max(self.until - self.begun, 1e-9), 0.0, 1.0)
        ends = np.stack([start + share * (self.to - start) for start in (self.low, self.high)])
        return np.stack([ends.min(axis=(0, 1)), ends.max(axis=(0, 1))])


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
    """Commands whose target is too far for one period."""
    worst_delay: float = 0.0
    """Longest time after its own at which a command was sent [s]."""


class Stream:
    """Commands to an armed hand at a fixed rate, on an absolute clock.

    ```python
    with HandLink(port) as link:
        link.arm(watchdog=0.5)
        stream = link.stream(period=0.05)
        for target in targets:
            servo = stream.send(target)   # waits for its time; the angles a period later
    ```
    Pauses of more than the watchdog's period need `HandLink.sleep`, and a new stream afterwards.

    Attributes:
        counts: what became of the commands.
        period: time between two commands [s].
    """

    def __init__(self, link: Line, period: float, early: float) -> None:
        if not _PERIODS[0] <= period <= _PERIODS[1]:
            raise FrameError(f"period = {period} s, allowed {_PERIODS[0]} to {_PERIODS[1]} s")
        if not 0 <= early <= period:
            raise FrameError(f"early = {early} s, allowed 0 to the period, {period} s")
        self.period = period
        self.counts = StreamCounts()
        self._link = link
        self._early = early
        status = link.status()
        # The moves that the hand may make, by the number of the command.
        self._ramps = {0: Ramp(status.servo, status.servo, status.servo, 0.0, 0.0, {})}
        self._share = status.rate_share
        self._status = link.last_status
        # The last command before a request of STATUS, and its time, by the request's number.
        self._asked: dict[int, tuple[int, float]] = {}
        self._exchange = link.exchange
        # Weak: a forgotten link, which the stream holds, must end.
        self._exchange.on_ack = WeakMethod(self._answered)
        self._waited = False
        self.begin()

    def send(self, target: ArrayLike) -> Array:
        """Wait for the next period, and send the command that leads towards a target.

        Args:
            target: servo angles, shape (6,) [rad].

        Returns:
            The angles that the hand has a period later if the command arrives: the target, or on
            the way to it as far as the rate limit allows; shape (6,) [rad].

        Raises:
            ShapeError: Another shape, or NaN.
            FaultError: A fault has latched. RejectedError: another program has taken the hand over.
            LinkTimeout, PortError: No answer to any command for a second; the port is gone.
        """
        target = self._link.board.within(as_finite_vector(target, len(SERVOS), "target"))
        if not self._waited:
            self.wait()
        self._waited = False
        now = self._exchange.transport.now()
        met = np.stack([ramp.poses(now, self._early) for ramp in self._ramps.values()])
        low = met[:, 0].min(axis=0)
        high = met[:, 1].max(axis=0)
        rate = self._share * self._link.board.built_for.servo_rate_limit
        reach = AHEAD * self.period * rate
        start = np.clip(met[-1].mean(axis=0), high - reach, low + reach)
        # All six arrive together, as in every move: the way is shortened, not bent.
        way = target - start
        room = np.where(way > 0, low + reach - start, start - high + reach).clip(min=0.0)
        share = min(1.0, *(room / np.maximum(np.abs(way), 1e-12)))
        steps = np.rint((start + share * way) / ANGLE_UNIT).astype(int)
        to: Array = steps * ANGLE_UNIT
        lasts = max(self.period, *(np.maximum(np.abs(to - low), np.abs(to - high)) / rate))
        duration_ms = math.ceil(1e3 * lasts - 1e-6)
        self.counts.limited += 1e-3 * duration_ms > self.period + 1e-9
        fields: Fields = {"duration_ms": duration_ms, "servo": tuple(steps.tolist())}
        number = self._link.send_unanswered("move", fields)
        self._ramps[number] = Ramp(low, high, to, now, now + 1e-3 * duration_ms, fields)
        self._asked[self._exchange.send("status")] = number, now
        self.counts.sent += 1
        later: Array = start + min(1.0, 1e3 * self.period / duration_ms) * (to - start)
        return later

    def begin(self) -> None:
        """The first command is due now: for programs that wait, with `HandLink.sleep`, between the
        making of a stream and its first command.
        """
        self._due = self._heard_at = self._exchange.transport.now()

    def close(self) -> None:
        """End the stream: later moves of the link are answered as usual. A stream that is not
        closed ends with its link.
        """
        self._link.status()
        self._exchange.on_ack = None

    def wait(self) -> None:
        """Wait for the time of the next command, which the next `send` then does not wait for: for
        programs that look at the world as late as they can. Errors as of `send`.
        """
        self._waited = True
        now = self._exchange.transport.now
        self._link.listen(max(self._due - now(), 0.0), "move")
        status = self._link.last_status
        if status is not None and status is not self._status:
            self._status = status
            self._told(status)
        if now() - self._heard_at > PATIENCE:
            raise LinkTimeout(f"no answer to a streamed move for {PATIENCE:g} s")
        delay = now() - self._due
        self.counts.worst_delay = max(self.counts.worst_delay, delay)
        self.counts.late += delay > LATE
        if (missed := int(delay / self.period)) > 0:  # no burst: the hand would refuse it
            self.counts.skipped += missed
            self._due += missed * self.period
        self._due += self.period

    def _told(self, status: HandStatus) -> None:
        """Take note of a STATUS: the hand makes one of the moves that came before its request, and
        was there.
        """
        self._share = status.rate_share
        last, asked = self._asked.pop(status.number, (-1, 0.0))
        if last in self._ramps:
            first = next(iter(self._ramps))
            accepted = status.last_seq if status.last_seq in self._ramps else first
            self._heard_at = self._exchange.transport.now()
            self._makes(accepted, last)
            ramp = self._ramps[accepted]
            there = status.servo
            until = max(ramp.until, asked)
            self._ramps[accepted] = replace(ramp, low=there, high=there, begun=asked, until=until)

    def _makes(self, accepted: int, last: int) -> None:
        """The hand makes one move, and no other one of those up to `last`."""
        numbers = list(self._ramps)
        for number in numbers[: numbers.index(last) + 1]:
            if number != accepted:
                self.counts.lost += number != numbers[0]
                del self._ramps[number]

    def _answered(self, ack: Frame) -> None:
        """Take note of an answer: the hand makes this move now, or does not."""
        if ack.seq not in self._ramps:
            return
        self._heard_at = self._exchange.transport.now()
        reason = ack.number("reason")
        if reason not in (Reason.ok, Reason.rate, Reason.hot):
            self._exchange.refused = Frame("move", fields=self._ramps[ack.seq].fields), ack
        if reason == Reason.ok:
            self.counts.acknowledged += 1
            self._makes(ack.seq, ack.seq)
            return
        del self._ramps[ack.seq]
        self.counts.refused += 1
        if reason == Reason.hot:
            self.counts.hot += 1
            self._share *= _SLOWER
