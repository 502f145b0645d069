"""One connection to a hand: from HELLO to the hand's confirmation that its pulses are off."""

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import RLock, current_thread
from time import monotonic

from hpac_gym.bridge.errors import (
    BridgeError,
    HandshakeError,
    LinkTimeout,
    PortError,
    RejectedError,
    StoppedError,
    UnconfirmedWarning,
    tell,
)
from hpac_gym.bridge.exchange import Exchange, LinkStatistics, WireLog
from hpac_gym.bridge.frame import Fields, Frame
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.last_words import TAKEN_OVER, release
from hpac_gym.bridge.protocol import VERSION, Fault, Reason, name_of
from hpac_gym.bridge.reports import HandInfo
from hpac_gym.bridge.transport import Transport

_HELLO_PERIOD = 0.1
_TEXT_SHARE = 0.9
NOISE = "line noise: a shorter cable, away from the servo wires"
_PREEMPT_PERIOD = 0.02
_PREEMPT_TIMEOUT = 3.0


class Turns:
    """Mutual exclusion of calls: they wait for each other, except `estop` and `close`, which
    pre-empt.
    """

    def __init__(self) -> None:
        self._lock = RLock()
        self._depth = 0
        self._preempted = 0
        self._stopped_by = ""

    def __enter__(self) -> None:
        self._lock.acquire()
        if self._depth == 0:
            self._stopped_by = ""
        self._depth += 1

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._depth -= 1
        stopped = self._stopped_by if self._depth == 0 and kind is None else ""
        self._lock.release()
        if stopped:
            raise StoppedError(f"stopped by {stopped}")

    def check(self) -> None:
        """End the current call if `preempt` has requested it.

        Raises:
            StoppedError: The call has been pre-empted.
        """
        if self._stopped_by and not self._preempted:
            raise StoppedError(f"stopped by {self._stopped_by}")

    @contextmanager
    def preempt(self, by: str, insist: Callable[[], object]) -> Iterator[None]:
        """Take the turn from the current call, which runs in another thread or was interrupted by a
        signal handler in this one.

        Args:
            by: name of the pre-empting call for the `StoppedError`.
            insist: called every 20 ms until another thread's call has ended; after 3 s it is
                ignored.
        """
        deadline = monotonic() + _PREEMPT_TIMEOUT
        taken = self._lock.acquire(blocking=False)
        while not taken and monotonic() < deadline:
            self._stopped_by = by
            with suppress(BridgeError):
                insist()
            taken = self._lock.acquire(timeout=_PREEMPT_PERIOD)
        within_a_call = self._depth > 0
        self._stopped_by = ""
        self._preempted += 1
        try:
            yield
        finally:
            self._preempted -= 1
            if within_a_call:
                self._stopped_by = by
            if taken:
                self._lock.release()


class Connection:
    """One connection and the state of the hand known through it. It ends exactly once, by `end`.

    Args:
        transport: an open transport; `end` closes it.
        turns: the link's mutual exclusion.
        timeout, attempts: time-out of one answer [s], and number of times that a frame is sent.

    Attributes:
        info: the hand's answer to HELLO.
        known: the state that the hand has reported.
        ended: whether the port is closed.
        watchdog: watchdog period of the armed hand [s].
        fed_at: time of the last message that fed the watchdog [s, the transport's clock].
        busy_until: end of the last move [s, the transport's clock].
    """

    def __init__(
        self,
        transport: Transport,
        turns: Turns,
        statistics: LinkStatistics,
        timeout: float,
        attempts: int,
        log: WireLog | None = None,
    ) -> None:
        self.info: HandInfo | None = None
        self.exchange = Exchange(transport, statistics, turns.check, log)
        self.known = self.exchange.known
        self._turns = turns
        self._timeout = timeout
        self._attempts = attempts
        self._owner = os.getpid()
        self.ended = False
        self.thread = current_thread()
        self.watchdog = math.inf
        self.fed_at = self.busy_until = 0.0
        interrupts.link_opened(self)

    def require_owner(self) -> None:
        """Refuse to talk in a forked child.

        Raises:
            PortError: Another process opened this connection.
        """
        if self._owner != os.getpid():
            raise PortError(f"this link belongs to process {self._owner}: open one of your own")

    def greet(self, patience: float) -> HandInfo:
        """Send HELLO for up to `patience` [s] and return the answer.

        Errors as of `greet`.
        """
        self.info = greet(self.exchange, patience)
        self._learn_fault()
        return self.info

    def request(self, name: str, fields: Fields | None = None, flags: int = 0) -> Frame:
        """Send a message, require that the hand executes it, and return the answer.

        Raises:
            RejectedError: The hand refuses it. FaultError: no answer, and the hand has been stopped.
            LinkTimeout, PortError: no answer; the port is gone.
        """
        try:
            answer = self.exchange.request(name, fields, flags, self._timeout, self._attempts)
        except LinkTimeout:  # another program's `hpac estop` may have read the answers
            self._ask_status()
            if self.known.in_fault and self.known.fault != Fault.watchdog.name:
                raise self.known.fault_error(f"{name} was not answered") from None
            raise
        if answer.name == "ack" and answer.number("reason") != Reason.ok:
            raise self._refusal(Frame(name, fields=fields or {}), answer)
        return answer

    def raise_unasked(self, what: str) -> None:
        """Raise a fault, or the refusal of an unacknowledged message, that the hand has reported in
        the meantime.
        """
        refused = self.exchange.refused
        self.exchange.refused = None
        if refused is not None:
            raise self._refusal(*refused)
        if self.known.in_fault:
            self._learn_fault()
            raise self.known.fault_error(what)

    def _refusal(self, message: Frame, answer: Frame) -> RejectedError:
        self.exchange.statistics.rejected += 1
        self._learn_fault()
        if answer.number("reason") == Reason.hot:
            self._ask_status()
        return self.known.refusal(message, answer)

    def _learn_fault(self) -> None:
        """Request the kind of a fault whose FAULT frame was lost."""
        if self.known.in_fault and self.known.fault == Fault.none.name:
            self._ask_status()

    def _ask_status(self) -> None:
        with suppress(LinkTimeout, PortError):
            self.exchange.request("status", timeout=self._timeout, attempts=self._attempts)

    @interrupts.closing
    def end(self, error: BaseException | None = None) -> None:
        """Leave the hand without pulses and release the port, whatever happens meanwhile.

        If the hand does not confirm, an `UnconfirmedWarning` is issued and a note is added to
        `error`, the propagating exception.

        Raises:
            KeyboardInterrupt, SystemExit: Received during the release; raised at its end, unless
            `error` is one already.
        """
        if self.ended:
            return
        unconfirmed = ""
        interrupt = None
        try:
            if self._owner == os.getpid():
                with self._turns.preempt("close()", lambda: self.exchange.send("clear")):
                    if not self.ended:
                        greeted = self.info is not None
                        unconfirmed, interrupt = release(self.exchange, greeted, self._timeout)
                        self.ended = True  # before the turn goes to another thread's call
                told = isinstance(error, RejectedError) and error.reason == Reason.session.name
                if unconfirmed and not (unconfirmed == TAKEN_OVER and told):
                    if error is not None:
                        error.add_note(unconfirmed)
                    if not isinstance(error, HandshakeError):
                        tell(UnconfirmedWarning(unconfirmed))
        finally:
            with suppress(Exception):  # must not replace the program's own exception
                self.exchange.transport.close()
            self.ended = True
            self.known.forget()
            interrupts.link_closed(self)
        already_ending = isinstance(error, KeyboardInterrupt | SystemExit)
        if interrupt is not None and not already_ending:
            raise interrupt
        interrupts.deliver(already_ending)


def greet(exchange: Exchange, patience: float, fields: Fields | None = None) -> HandInfo:
    """Send HELLO for up to `patience` [s] and return the answer.

    Raises:
        HandshakeError: No answer, or not from a hand of this protocol: what the device is; the first
            remedy.
        PortError: The port is gone.
    """
    attempts = max(1, math.ceil(patience / _HELLO_PERIOD))
    received = exchange.statistics.received
    try:
        answer = exchange.request("hello", fields, timeout=_HELLO_PERIOD, attempts=attempts)
    except LinkTimeout:
        some = "a hand that answers only some messages; " + NOISE
        partly = exchange.statistics.received > received
        raise HandshakeError(some if partly else _unlike_a_hand(exchange, patience)) from None
    return HandInfo.from_frame(require_answer("hello", answer))


def require_answer(name: str, answer: Frame) -> Frame:
    """The answer to a question, which a hand does not answer with an ACK.

    Raises:
        HandshakeError: It is an ACK.
    """
    if answer.name == "ack":
        reason = name_of(Reason, answer.number("reason"))
        raise HandshakeError(
            f"a device that answers {name.upper()} with an ACK ({reason}); flash the hand's firmware of this version"
        )
    return answer


def _unlike_a_hand(exchange: Exchange, patience: float) -> str:
    """What a device is that has not answered HELLO for `patience` [s], and the first remedy."""
    heard = exchange.splitter.tail
    if exchange.host_frames:
        return (
            f"no hand answers, but an echo: what is sent comes back ({len(heard)} bytes); "
            "take off a jumper between TX and RX, or switch the device's echo off"
        )
    if (version := exchange.splitter.other_version) is not None:
        return (
            f"a hand that speaks protocol {version}, this library {VERSION}; "
            "flash the firmware of this version of hpac_gym, or install the version that the firmware came with"
        )
    if not heard:
        return (
            f"no hand answers: silence for {patience:g} s; "
            "is the board powered and flashed with the hand's firmware? see firmware/board/esp32/README.md"
        )
    if sum(byte in b"\r\n\t" or 32 <= byte < 127 for byte in heard) >= _TEXT_SHARE * len(heard):
        line = max(heard.decode("ascii", "replace").split("\n"), key=len).strip()[:60]
        return (
            f"no hand answers: text instead of frames ({len(heard)} bytes, such as {line!r}); "
            "another firmware, or log text on the command port: flash the hand's, or move its console (sdkconfig.defaults)"
        )
    return (
        f"no hand answers: {len(heard)} bytes that are neither frames nor text; "
        "another baud rate, or noise: check the rate (460,800), ground, and that TX meets RX"
    )
