"""A connection to one hand that can be opened again: status, e-stop and clear; it ends with the hand without pulses."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from time import monotonic, sleep
from typing import ParamSpec, Self, TypeVar

from hpac_gym.bridge.connection import Connection, Turns
from hpac_gym.bridge.errors import BridgeError, HandshakeError, PortError, StoppedError
from hpac_gym.bridge.exchange import LinkStatistics, WireLog
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.protocol import State
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.transport import Transport, open_transport

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def turn(method: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """A method that talks to the hand: one at a time, and only in the process that opened the link."""

    @wraps(method)
    def call(self: Line, *args: object, **kwargs: object) -> _Result:
        if self._connection is not None:
            self._connection.require_owner()
        try:
            with self._turns:
                return method(self, *args, **kwargs)
        except StoppedError:  # whatever this call took in last may be older than the e-stop
            with suppress(BridgeError), self._turns:
                self._connection.request("status", {"period_ms": 0})
            raise

    return call


class Line:
    """A connection that may look at a hand, stop it, clear it and let it go safely, whether it is armed or not.

    `HandLink` is a line that also drives the hand, and tells more.

    Args:
        port: name of a port (see `open_transport`), or a function that opens a transport, `VirtualHand.connect` say.
        timeout: patience with one answer [s].
        attempts: how often a frame is sent before `LinkTimeout`.
        handshake_timeout: patience with HELLO [s]; boards that reset when the port opens need 1 to 2 s.
        log: gets every frame.

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
        """The hand's last known state, of `protocol.State`; `boot` when not connected."""
        return self._connection.known.state if self._connection else State.boot.name

    @property
    def last_status(self) -> HandStatus | None:
        """The latest STATUS, asked for or periodic."""
        return self._connection.known.status if self._connection else None

    def __enter__(self) -> Self:
        self.connect()
        return self

    @interrupts.closing
    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        self._end(error)

    @interrupts.closing
    def close(self) -> None:
        """Leave the hand without pulses and let the port go. May be called twice, from any thread and a signal handler.

        A hand that does not confirm it is told of in an `UnconfirmedWarning`; no error is raised. Signals wait until the
        end. A link that is forgotten open is closed when it is collected or the program ends.
        """
        self._end(None)

    def _end(self, error: BaseException | None) -> None:
        if self._connection is not None:
            self._connection.end(error)
            self._when_forgotten.detach()

    def connect(self) -> HandInfo:
        """Open the port and greet the hand. Afterwards it is not armed, whatever it was before.

        Raises:
            PortError: The port cannot be opened.
            HandshakeError: Nothing answers, or a firmware of another protocol version.
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
        """Wait until the port is there again [s, wall clock], and connect. The hand is then not armed.

        Raises:
            PortError, HandshakeError: It did not come back in time; the last reason.
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
        """Stop all pulses now and latch a fault, in any state. From any thread and from a signal handler: the call that is
        under way ends with `StoppedError`.

        Raises:
            LinkTimeout, PortError: It is not confirmed: switch the servo supply off.
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
        """Ask what the hand does; from now on it also says so by itself every `period` [s], or not at all for 0.

        Raises:
            RejectedError: A period below 10 ms.
        """
        self._connected().request("status", {"period_ms": round(period * 1e3)})
        return self.last_status

    def _connected(self) -> Connection:
        if self._connection is None or self._connection.ended:
            raise PortError("not connected")
        return self._connection
