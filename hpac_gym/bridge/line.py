"""One line to a hand, and the part of a link that works in every state of the hand: query, e-stop,
clear, and a safe end.

No call blocks indefinitely.
"""

import math
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from typing import Concatenate, ParamSpec, Self, TypeVar

from hpac_gym.bridge.connection import Connection, Turns
from hpac_gym.bridge.errors import (
    BridgeError,
    FaultError,
    FrameError,
    PortError,
    StoppedError,
)
from hpac_gym.bridge.exchange import Exchange, LinkStatistics, WireLog
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.limits import BoardTable
from hpac_gym.bridge.protocol import Fault, Fields, State
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.model import HPAC, Hand

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
_Link = TypeVar("_Link", bound="Line")


def milliseconds(name: str, seconds: float) -> int:
    """A time as a field of 16 bits, rounded up [ms].

    Raises:
        FrameError: It does not fit; the message calls it `name`.
    """
    if not 0 <= seconds <= 0xFFFF * 1e-3:
        raise FrameError(f"{name} = {seconds} s, allowed 0 to 65.535 s")
    return math.ceil(seconds * 1e3 - 1e-6)


def turn(
    method: Callable[Concatenate[_Link, _Given], _Result],
) -> Callable[Concatenate[_Link, _Given], _Result]:
    """Decorate a method that talks to the hand: one call at a time, only in the process that opened
    the link.
    """

    @wraps(method)
    def call(self: _Link, /, *args: _Given.args, **kwargs: _Given.kwargs) -> _Result:
        if self._connection is not None:
            self._connection.require_owner()
        try:
            with self._turns:
                return method(self, *args, **kwargs)
        except StoppedError:  # the status received last may be older than the e-stop
            with suppress(BridgeError), self._turns:
                self._connected().request("status")
            raise

    return call


class Line:
    """The part of `HandLink` that works in every state of the hand: query, e-stop, clear, and a
    safe end.
    """

    def __init__(
        self,
        port: str | Callable[[], Transport],
        *,
        hand: Hand = HPAC,
        timeout: float = 0.1,
        attempts: int = 3,
        handshake_timeout: float = 3.0,
        log: WireLog | None = None,
    ) -> None:
        interrupts.install()
        self._port = port
        self.board = BoardTable(hand)
        self._timeout = timeout
        self._attempts = attempts
        self._handshake_timeout = handshake_timeout
        self._log = log
        self._turns = Turns()
        self._connection: Connection | None = None
        self.statistics = LinkStatistics()

    @property
    def info(self) -> HandInfo | None:
        """The hand's answer to HELLO; None before the first."""
        return self._connection.info if self._connection else None

    @property
    def state(self) -> str:
        """The hand's last known state, a name of `protocol.State`; `boot` if not connected."""
        return self._connection.known.state if self._connection else State.boot.name

    @property
    def last_status(self) -> HandStatus | None:
        """The latest STATUS, requested or periodic."""
        return self._connection.known.status if self._connection else None

    def __enter__(self) -> Self:
        self.connect()
        return self

    @interrupts.closing
    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        self._end(error)

    @interrupts.closing
    def close(self) -> None:
        """Leave the hand without pulses and release the port. May be called repeatedly, from any
        thread or signal handler.

        A hand that relaxes in a fault is waited for, up to 5 s, and a fault stays latched. If the hand
        does not confirm that its pulses are off, an `UnconfirmedWarning` is issued; no error is raised.
        Signals are delayed until the end. A link that was not closed is closed when it is
        garbage-collected or the program ends."""
        self._end(None)

    def _end(self, error: BaseException | None) -> None:
        if self._connection is not None:
            self._connection.end(error)
            self._when_forgotten.detach()

    def connect(self) -> HandInfo:
        """Open the port and perform the handshake. Afterwards the hand is not armed, whatever its
        state was before.

        Raises:
            PortError: The port cannot be opened.
            HandshakeError: Nothing answers, or the firmware has another protocol version.
        """
        self.close()
        connection = Connection(
            open_transport(self._port),
            self._turns,
            self.statistics,
            self._timeout,
            self._attempts,
            self._log,
        )
        self._connection = connection
        self._when_forgotten = weakref.finalize(self, connection.end)
        try:
            with self._turns:
                return connection.greet(self._handshake_timeout)
        except BaseException as error:
            self._end(error)
            raise

    def estop(self) -> None:
        """Stop all pulses now and latch a fault, in any state, from any thread or signal handler. A
        call in progress ends with `StoppedError`.

        Raises:
            LinkTimeout, PortError: The stop is not confirmed: switch the servo supply off.
        """
        connection = self._connected()
        connection.require_owner()
        with self._turns.preempt("estop()", lambda: connection.exchange.send("estop")):
            try:
                self._connected().request("estop")
            except FaultError:  # unanswered, but a later STATUS confirms it
                if connection.known.fault != Fault.estop.name or connection.known.may_have_power:
                    raise

    @turn
    def clear(self) -> None:
        """Disarm, or leave a latched fault: no motion, no pulses, state IDLE.

        Raises:
            RejectedError: The fault cannot be cleared: the board's own servo table is unusable, or its
                e-stop input is pressed.
        """
        self._connected().request("clear")

    @turn
    def status(self, period: float = 0.0) -> HandStatus:
        """Request STATUS; the hand then also sends it every `period` [s], until the next request, as by
        `wait` and `arm`, or not at all for 0.

        Raises:
            RejectedError: The period is below 10 ms.
        """
        fields = {"period_ms": milliseconds("period", period)}
        return HandStatus.from_frame(self._connected().request("status", fields))

    def _connected(self) -> Connection:
        if self._connection is None or self._connection.ended:
            raise PortError("not connected")
        return self._connection

    @property
    def exchange(self) -> Exchange:
        """The exchange of frames of the present connection."""
        return self._connected().exchange

    @turn
    def send_unanswered(self, name: str, fields: Fields) -> int:
        """Send a message that feeds the watchdog without waiting for its answer; returns its
        number.
        """
        connection = self._connected()
        connection.fed_at = self._now()
        return connection.exchange.send(name, fields)

    @turn
    def listen(self, seconds: float, what: str) -> None:
        """Receive for `seconds` without heartbeats, and raise the fault that the hand reports."""
        connection = self._connected()
        connection.exchange.listen(seconds)
        connection.raise_unasked(what)

    def _now(self) -> float:
        return self._connected().exchange.transport.now()
