"""The link to one hand: handshake, arming, moves, heartbeat, e-stop, and an end without pulses. No call blocks for ever."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from time import monotonic, sleep
from typing import ParamSpec, TypeVar

import numpy as np

from hpac_gym.bridge.connection import Connection, Turns
from hpac_gym.bridge.errors import BridgeError, HandshakeError, LinkTimeout, PortError, StoppedError
from hpac_gym.bridge.exchange import LinkStatistics, WireLog
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.protocol import ANGLE_UNIT, CONSTANTS, FLAG_MINIMUM_JERK, FLAG_NO_ACK, Action, State
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.model import HPAC, SERVOS, Hand, ServoCommand

_ARM_POLL = 0.05
_HEARTBEATS_PER_WATCHDOG = 4

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")


def _turn(method: Callable[_Given, _Result]) -> Callable[_Given, _Result]:
    """A method that talks to the hand: one at a time, and only in the process that opened the link."""

    @wraps(method)
    def call(self: HandLink, *args: object, **kwargs: object) -> _Result:
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


class HandLink:
    """A hand at the other end of a wire; connects on entry, and on exit leaves it without pulses.

    ```python
    with HandLink("/dev/ttyUSB0") as link:
        link.arm()
        for command in commands:      # one every command.duration: move() waits for the one before to end
            link.move(command)
        link.wait()
    ```
    There is no hidden thread: a program that hangs falls silent, and after `info.watchdog` the hand does what `arm` was
    told. Use `sleep` instead of `time.sleep` while armed; it sends heartbeats. Calls from several threads wait for each
    other; `estop` and `close` do not wait, and may come from a signal handler: the call that they interrupt raises
    `StoppedError`. A fork's child cannot use its parent's link, and does not disturb it.

    Args:
        port: name of a port (see `open_transport`), or a function that opens a transport, `VirtualHand.connect` say.
        hand: whose limits the firmware must have been built with.
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
        hand: Hand = HPAC,
        timeout: float = 0.1,
        attempts: int = 3,
        handshake_timeout: float = 3.0,
        log: WireLog | None = None,
    ) -> None:
        self._open = (lambda: open_transport(port)) if isinstance(port, str) else port
        self._hand = hand
        self._patience = {"timeout": timeout, "attempts": attempts}
        self._handshake_timeout = handshake_timeout
        self._log = log
        self._turns = Turns()
        self._connection: Connection | None = None
        self._busy_until = 0.0
        self._fed_at = 0.0
        self._watchdog = math.inf
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

    def __enter__(self) -> HandLink:
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
        self._busy_until = 0.0
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

    @_turn
    def arm(self, action: Action = Action.relax, watchdog: float = CONSTANTS["watchdog_ms"] * 1e-3) -> None:
        """Arm the hand and wait until all servos have pulses, one after the other, and stand at rest.

        Args:
            action: what the hand does when this program falls silent. `hold` relaxes as well, after 30 s.
            watchdog: for how long it may be silent, 0.1 to 2 [s].

        Raises:
            HandshakeError: The firmware was built with other limits than those of `hand`.
            RejectedError: Not in IDLE, a servo is too hot, or `watchdog` out of bounds. FaultError: clear a fault first.
            LinkTimeout: No answer, or not all servos got pulses.
        """
        self._connected().info.check_limits(self._hand)
        fields = {"limits_hash": self.info.limits_hash, "watchdog_ms": round(watchdog * 1e3), "action": int(action)}
        self._feed("arm", fields)
        self._watchdog = watchdog
        deadline = self._now() + CONSTANTS["start_max_ms"] * 1e-3
        while len(self.status().attached) < len(SERVOS) or self.last_status.moving:
            if self._now() > deadline:
                raise LinkTimeout(f"after {CONSTANTS['start_max_ms'] * 1e-3:g} s pulses at {self.last_status.attached} alone")
            self.sleep(_ARM_POLL)
        self._busy_until = self._now()

    @_turn
    def move(self, command: ServoCommand, *, minimum_jerk: bool = False, acknowledge: bool = True, pace: bool = True) -> None:
        """Send one synchronised move, and wait for the hand's ACK.

        The duration goes out in whole ms, rounded up, so that no move gets faster; angles in 1e-4 rad.

        Args:
            minimum_jerk: a smooth move from the present pose and velocity, instead of a linear one from the pose.
            acknowledge: False asks for no ACK and does not wait; a refusal or a fault is raised by the first call after it
                has come.
            pace: first wait until the move before has ended. False pre-empts it.

        Raises:
            FrameError: An angle beyond ±3.2767 rad, or a duration beyond 65.535 s.
            RejectedError: Outside of the limits, too fast, or not armed. FaultError: a fault has latched.
            LinkTimeout, PortError: No answer; the port has gone.
        """
        duration_ms = math.ceil(command.duration * 1e3 - 1e-6)
        steps = np.rint(np.asarray(command.servo) / ANGLE_UNIT).astype(int)
        fields = {"duration_ms": duration_ms, "servo": tuple(steps.tolist())}
        flags = FLAG_MINIMUM_JERK if minimum_jerk else 0
        if pace:
            self.sleep(self._busy_until - self._now())
        if acknowledge:
            self._feed("move", fields, flags)
        else:
            self._connected().exchange.send("move", fields, flags | FLAG_NO_ACK)
            self._connected().exchange.listen(0)
            self._connected().raise_unasked("move")
        self._busy_until = self._now() + duration_ms * 1e-3

    @_turn
    def wait(self) -> HandStatus:
        """Let time pass until the hand says that the move has ended.

        Raises:
            FaultError: A fault latched meanwhile.
            LinkTimeout: It still says that it moves long after the move's duration.
        """
        self.sleep(self._busy_until - self._now())
        deadline = self._now() + 1.0
        while (status := self.status()).moving:
            if self._now() > deadline:
                raise LinkTimeout("the hand still moves 1 s after the move should have ended")
            self.sleep(1e-3)
        return status

    @_turn
    def sleep(self, seconds: float) -> None:
        """Let time pass, with heartbeats while armed; returns at once for `seconds` ≤ 0.

        Raises:
            FaultError: A fault latched meanwhile.
            LinkTimeout, PortError: A heartbeat got no answer; the port has gone.
        """
        deadline = self._now() + seconds
        was_armed = self._connected().known.armed
        period = self._watchdog / _HEARTBEATS_PER_WATCHDOG
        while (left := deadline - self._now()) > 0:
            due = self._fed_at + period
            self._connected().exchange.listen(min(left, max(due - self._now(), 0.0)) if was_armed else left)
            if was_armed and self._now() >= due:
                self.heartbeat()
            if was_armed:
                self._connected().raise_unasked("it latched while waiting")

    @_turn
    def heartbeat(self) -> str:
        """Tell the hand that this program is alive; returns the hand's state, of `protocol.State`."""
        self._feed("heartbeat")
        return self.state

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

    @_turn
    def clear(self) -> None:
        """Disarm, or leave a latched fault: no motion, no pulses, state IDLE.

        Raises:
            RejectedError: The fault cannot be cleared: the board's own servo table is unusable.
        """
        self._connected().request("clear")

    @_turn
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

    def _now(self) -> float:
        return self._connected().exchange.transport.now()

    def _feed(self, name: str, fields: dict | None = None, flags: int = 0) -> None:
        """Send what also feeds the hand's watchdog."""
        sent_at = self._now()
        self._connected().request(name, fields, flags)
        self._fed_at = sent_at
