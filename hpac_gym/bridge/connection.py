"""One connection to a hand: from HELLO to the hand's confirmation that its pulses are off.

The last words are CLEAR, then ESTOP. A hand that relaxes in a fault is waited for, and one without
pulses in a fault is left in it."""

import math
import os
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import RLock, current_thread
from time import monotonic

from hpac_gym.bridge.doctor import greet
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
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.protocol import Fault, Fields, Frame, Reason
from hpac_gym.bridge.reports import HandInfo
from hpac_gym.bridge.transport import Transport
from hpac_gym.progress import Late

TAKEN_OVER = (
    "another program has greeted the hand since, or the board has restarted: it is left as it is"
)
LAST_WORDS_TIME = 3.0
"""How long a silent hand is asked to switch its pulses off [s]."""
RELAX_TIME = 5.0
"""How long a hand that relaxes is waited for [s]: the nominal one needs 3.2 (chosen)."""
_POLL = 0.05
_ATTEMPTS: tuple[tuple[str, ...], ...] = (("clear", "status"),) * 3 + (("estop", "status"),) * 2
"""Messages that end the pulses, each with a question after the state if it was refused."""
_ATTEMPTS_UNGREETED = (("hello", "status"), ("clear", "status")) * 3
"""The same for a device that never answered: not a hand, perhaps, or one that an earlier session
left holding in a fault; sent once, since nothing says that a hand is there.
"""
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
                        unconfirmed, interrupt = last_words(self.exchange, greeted, self._timeout)
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


def last_words(
    exchange: Exchange, greeted: bool, timeout: float
) -> tuple[str, BaseException | None]:
    """Send the last words: all of them once, and then again for `LAST_WORDS_TIME`.

    Args:
        greeted: whether the hand has answered HELLO.
        timeout: time-out of one answer [s].

    Returns:
        A sentence on the failed attempts, empty if the hand has confirmed; and the interrupt
        received in the meantime (`KeyboardInterrupt`, `SystemExit`), or None.
    """
    known = exchange.known
    told = known.in_fault
    interrupt = _relaxed(exchange, timeout) if greeted and known.may_have_power else None
    fault = known.fault
    until = exchange.transport.now() + LAST_WORDS_TIME
    sent: Counter[str] = Counter()
    failure = "no answer"
    port_gone = False
    late = Late("asking the hand to stop: no answer yet")
    attempts = _ATTEMPTS if greeted else _ATTEMPTS_UNGREETED
    while known.may_have_power and attempts:
        for messages in attempts:
            late()
            try:
                for name in messages:
                    if known.may_have_power:
                        if name == "clear" and known.fault == Fault.estop.name:
                            name = "estop"  # CLEAR would leave the fault
                        sent[name] += 1
                        answer = exchange.request(name, timeout=timeout, attempts=1, late=True)
                        if answer.name == "ack" and answer.number("reason") == Reason.session:
                            return TAKEN_OVER, interrupt
            except LinkTimeout:
                pass
            except Exception as error:
                failure = str(error)
                port_gone = isinstance(error, PortError)
            except BaseException as error:
                interrupt = interrupt or error
        again = greeted and not port_gone and exchange.transport.now() < until
        attempts = _ATTEMPTS if again else ()
    if not known.may_have_power:
        if sent["estop"] and fault != Fault.estop.name:
            tell(
                UserWarning(
                    "CLEAR was not answered in time, ESTOP was sent: `hpac clear` leaves it"
                )
            )
        elif known.in_fault and not told:
            tell(UserWarning(f"the hand is in fault ({known.fault}): `hpac clear` leaves it"))
        return "", interrupt
    tried = ", ".join(f"{name.upper()} × {count}" for name, count in sent.items())
    advice = "if the servos hold, switch their supply off; the hand's watchdog acts by itself if it was armed"
    return (
        f"the hand has not confirmed that it has no pulses (sent {tried or 'nothing'}: {failure}); {advice}",
        interrupt,
    )


def _relaxed(exchange: Exchange, timeout: float) -> BaseException | None:
    """Ask a hand in a fault after its state, which may confirm that it has no pulses, and wait while
    it relaxes; returns the interrupt received in the meantime, which ends the wait. Whether it is
    in one is asked once: the stop of another program may have read what the hand said.
    """
    known = exchange.known
    until = exchange.transport.now() + RELAX_TIME
    late = Late("waiting until the hand has relaxed")
    try:
        if not known.in_fault:  # pulses stay on while this waits
            exchange.request("hello", {"nonce": 0}, timeout=min(timeout, 0.1), attempts=1)
        while known.in_fault and exchange.transport.now() < until:
            exchange.request("status", timeout=timeout, attempts=10)
            if not (known.may_have_power and known.status and known.status.moving):
                break
            late()
            exchange.listen(_POLL)
    except Exception:  # the last words tell
        return None
    except BaseException as error:
        return error
    return None
