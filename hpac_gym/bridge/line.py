"""A reconnectable link to one hand with status, e-stop and clear; on closing it leaves the hand without pulses."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from time import monotonic, sleep
from typing import ParamSpec, Self, TypeVar

from hpac_gym.bridge.connection import Connection, Turns
from hpac_gym.bridge.errors import BridgeError, FrameError, HandshakeError, PortError, StoppedError
from hpac_gym.bridge.exchange import LinkStatistics, WireLog
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.protocol import State
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.transport import Transport, open_transport

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def milliseconds(name: str, seconds: float, rounded: Callable[[float], int] = round) -> int:
    """A time as a field of 16 bits [ms].

    Raises:
        FrameError: It does not fit; the message calls it `name`.
    """
    if not 0 <= seconds <= 0xFFFF * 1e-3:
        raise FrameError(f"{name} = {seconds} s, allowed 0 to 65.535 s")
    return rounded(seconds * 1e3)


def turn(method: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """Decorate a method that talks to the hand: one call at a time, only in the process that opened the link."""

    @wraps(method)
    def call(self: Line, *args: object, **kwargs: object) -> _Result:
        if self._connection is not None:
            self._connection.require_owner()
        try:
            with self._turns:
                return method(self, *args, **kwargs)
        except StoppedError:  # the status received last may be older than the e-stop
            with suppress(BridgeError), self._turns:
                self._connection.request("status", {"period_ms": 0})
            raise

    return call


class Line:
    """A connection that can query a hand, stop it, clear it and release it safely, whether it is armed or not.

    `HandLink` is a line that also drives the hand, and has more documentation.

    Args:
        port: name of a port (see `open_transport`), or a function that opens a transport, such as `VirtualHand.connect`.
        timeout: time-out of one answer [s].
        attempts: number of times that a frame is sent before `LinkTimeout`.
        handshake_timeout: time-out of HELLO [s]; boards that reset when the port opens need 1 to 2 s.
        log: log of every frame.

    Attributes:
        statistics: counters and round trips, over all connections.
    """

    def __init__(
        self,
        port: str | Callable[[], Transport],
        *,
        timeout: float = 0.1,
        attempts: int = 3,
        handshake_timeout: float = 3.0,
        log: WireLog | None = None,
    ) -> None:
        self._open = (lambda: open_transport(port)) if isinstance(port, str) else port
        self._patience = {"timeout": timeout, "attempts": attempts}
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
        """Leave the hand without pulses and release the port. May be called repeatedly, from any thread or signal handler.

        If the hand does not confirm this, an `UnconfirmedWarning` is issued; no error is raised. Signals are delayed until the
        end. A link that was not closed is closed when it is garbage-collected or the program ends.
        """
        self._end(None)

    def _end(self, error: BaseException | None) -> None:
        if self._connection is not None:
            self._connection.end(error)
            self._when_forgotten.detach()

    def connect(self) -> HandInfo:
        """Open the port and perform the handshake. Afterwards the hand is not armed, whatever its state was before.

        Raises:
            PortError: The port cannot be opened.
            HandshakeError: Nothing answers, or the firmware has another protocol version.
        """
        self.close()
        connection = Connection(self._open(), self._turns, self.statistics, log=self._log, **self._patience)
        self._connection = connection
        self._when_forgotten = weakref.finalize(self, connection.end)
        try:
            with self._turns:
                connection.greet(self._handshake_timeout)
        except BaseException as error:
            self._end(error)
            raise
        return connection.info

    def reconnect(self, timeout: float = 10.0) -> HandInfo:
        """Wait for the port for up to `timeout` [s, wall clock], and connect. The hand is then not armed.

        Raises:
            PortError, HandshakeError: The port did not return in time; the last reason is given.
        """
        deadline = monotonic() + timeout
        while True:
            try:
                return self.connect()
            except (PortError, HandshakeError):
                if monotonic() >= deadline:
                    raise
                sleep(0.05)

    def estop(self) -> None:
        """Stop all pulses now and latch a fault, in any state, from any thread or signal handler. A call in progress ends with
        `StoppedError`.

        Raises:
            LinkTimeout, PortError: The stop is not confirmed: switch the servo supply off.
        """
        connection = self._connected()
        connection.require_owner()
        with self._turns.preempt("estop()", lambda: connection.exchange.send("estop")):
            self._connected().request("estop")

    @turn
    def clear(self) -> None:
        """Disarm, or leave a latched fault: no motion, no pulses, state IDLE.

        Raises:
            RejectedError: The fault cannot be cleared: the board's own servo table is unusable.
        """
        self._connected().request("clear")

    @turn
    def status(self, period: float = 0.0) -> HandStatus:
        """Request STATUS; the hand then also sends it every `period` [s], or not at all for 0.

        Raises:
            RejectedError: The period is below 10 ms.
        """
        self._connected().request("status", {"period_ms": milliseconds("period", period)})
        return self.last_status

    def _connected(self) -> Connection:
        if self._connection is None or self._connection.ended:
            raise PortError("not connected")
        return self._connection
