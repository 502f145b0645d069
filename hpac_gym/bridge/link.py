"""The link to one hand: connecting, arming, moves, heartbeat, e-stop; on closing it leaves the hand
without pulses.

No call blocks indefinitely.
"""

from __future__ import annotations

import math
import warnings
import weakref
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from time import monotonic, sleep
from typing import Concatenate, ParamSpec, Self, TypeVar

import numpy as np

from hpac_gym.bridge.connection import Connection, Turns
from hpac_gym.bridge.errors import (
    BridgeError,
    ClippedWarning,
    FrameError,
    HandshakeError,
    LinkTimeout,
    PortError,
    StoppedError,
)
from hpac_gym.bridge.exchange import Exchange, LinkStatistics, WireLog
from hpac_gym.bridge.frame import Fields
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.bridge.protocol import (
    ANGLE_UNIT,
    CONSTANTS,
    FLAG_MINIMUM_JERK,
    FLAG_NO_ACK,
    Action,
    State,
)
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.stream import EARLY, Stream
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.model import HPAC, SERVOS, Hand, ServoCommand
from hpac_gym.model.checks import Array

_Given = ParamSpec("_Given")
_Result = TypeVar("_Result")
_Link = TypeVar("_Link", bound="Line")
_ARM_POLL = 0.05
_STEP_MAX = 0x7FFF
_HEARTBEATS_PER_WATCHDOG = 4


def milliseconds(name: str, seconds: float, rounded: Callable[[float], int] = round) -> int:
    """A time as a field of 16 bits [ms].

    Raises:
        FrameError: It does not fit; the message calls it `name`.
    """
    if not 0 <= seconds <= 0xFFFF * 1e-3:
        raise FrameError(f"{name} = {seconds} s, allowed 0 to 65.535 s")
    return rounded(seconds * 1e3)


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
                self._connected().request("status", {"period_ms": 0})
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
        self._hand = hand
        self._table = hand
        self._told_clipped = False
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

        If the hand does not confirm this, an `UnconfirmedWarning` is issued; no error is raised.
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

    def reconnect(self, timeout: float = 10.0) -> HandInfo:
        """Wait for the port for up to `timeout` [s, wall clock], and connect. The hand is then not
        armed.

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
        """Stop all pulses now and latch a fault, in any state, from any thread or signal handler. A
        call in progress ends with `StoppedError`.

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
        fields = {"period_ms": milliseconds("period", period)}
        return HandStatus.from_frame(self._connected().request("status", fields))

    def _connected(self) -> Connection:
        if self._connection is None or self._connection.ended:
            raise PortError("not connected")
        return self._connection


class HandLink(Line):
    """A connection to a hand, opened on entry; on exit it leaves the hand without pulses.

    ```python
    with HandLink("/dev/ttyUSB0") as link:
        link.arm()
        for command in commands:      # one per command.duration: move() waits for the previous one to end
            link.move(command)
        link.wait()
    ```
    There is no background thread: if the program hangs, the watchdog expires and the hand executes
    the safe action given to `arm`. Use `sleep` instead of `time.sleep` while armed; it sends
    heartbeats. Calls from several threads wait for each other; `estop` and `close` do not wait, and
    may be called from a signal handler: the call that they interrupt raises `StoppedError`. A
    forked child cannot use its parent's link, and does not disturb it.

    Args:
        port: name of a port (see `open_transport`), or a function that opens a transport, such as
            `VirtualHand.connect`.
        hand: the hand that is commanded, for which the firmware must have been built; a calibrated
            hand is also commanded on a board with the nominal table, within whose range its
            commands are clipped (`ClippedWarning`).
        timeout: time-out of one answer [s].
        attempts: number of times that a frame is sent before `LinkTimeout`.
        handshake_timeout: time-out of HELLO [s]; boards that reset when the port opens need 1 to 2
            s.
        log: log of every frame.

    Attributes:
        statistics: counters and round trips, over all connections.
    """

    @turn
    def arm(
        self, action: Action = Action.relax, watchdog: float = CONSTANTS["watchdog_ms"] * 1e-3
    ) -> None:
        """Arm the hand and wait until all servos have pulses, one after the other, and are at rest.

        The first pulse of a servo is at rest, to which the springs have pulled it; on a board that
        was told that its servos hold without power, at its last commanded angle.

        Args:
            action: safe action of the hand when this program stops sending. `hold` also relaxes,
                after 30 s. If the link fails, `relax` keeps the pulses for up to 3.2 s after the
                watchdog, `hold` for up to 33.2 s; `detach` stops them at once.
            watchdog: longest silence before the safe action, 0.1 to 2 [s].

        Raises:
            HandshakeError: The firmware was built with other limits than those of `hand`.
            RejectedError: Not in IDLE, a servo is too hot, or `watchdog` is out of bounds.
                FaultError: a fault is latched.
            ValueError, FrameError: No such action, or a `watchdog` beyond 65.535 s.
            LinkTimeout: No answer, or not all servos got pulses.
        """
        connection = self._connected()
        connection.raise_unasked("arm refused")  # a bad table is a fault before it is another table
        if (info := connection.info) is None:
            raise PortError("not connected")
        self._table = info.table_of(self._hand)
        connection.known.limits = servo_limits(self._table)
        fields = {
            "limits_hash": info.limits_hash,
            "watchdog_ms": milliseconds("watchdog", watchdog),
            "action": int(Action(action)),
        }
        self._feed("arm", fields)
        connection.watchdog = watchdog
        deadline = self._now() + CONSTANTS["start_max_ms"] * 1e-3
        while len((status := self.status()).attached) < len(SERVOS) or status.moving:
            connection.raise_unasked("it latched while arming")
            if self._now() > deadline:
                raise LinkTimeout(
                    f"after {CONSTANTS['start_max_ms'] * 1e-3:g} s pulses at {status.attached} alone"
                )
            self.sleep(_ARM_POLL)
        connection.busy_until = self._now()

    @turn
    def move(
        self,
        command: ServoCommand,
        *,
        minimum_jerk: bool = False,
        acknowledge: bool = True,
        pace: bool = True,
    ) -> None:
        """Send one synchronised move, and wait for the hand's ACK.

        The duration is sent in whole ms, rounded up, so that no move gets faster; angles in units
        of 1e-4 rad.

        Args:
            minimum_jerk: a smooth move from the present pose and velocity, instead of a linear one
                from the pose.
            acknowledge: False requests no ACK and does not wait; a refusal or a fault is raised by
                the first call after its arrival.
            pace: first wait until the previous move has ended. False pre-empts it.

        Raises:
            FrameError: An angle beyond ±3.2767 rad, or a duration beyond 65.535 s.
            RejectedError: Outside the limits, too fast, or not armed. FaultError: a fault is
                latched.
            LinkTimeout, PortError: No answer; the port is gone.
        """
        duration_ms = milliseconds("duration", command.duration, lambda ms: math.ceil(ms - 1e-6))
        steps = np.rint(self.within_table(command.servo) / ANGLE_UNIT).astype(int)
        if np.abs(steps).max() > _STEP_MAX:
            worst = max(command.servo, key=abs)
            raise FrameError(
                f"a servo angle of {worst:g} rad, allowed ±{_STEP_MAX * ANGLE_UNIT:g} rad"
            )
        fields: Fields = {"duration_ms": duration_ms, "servo": tuple(steps.tolist())}
        flags = FLAG_MINIMUM_JERK if minimum_jerk else 0
        connection = self._connected()
        if pace:
            self.sleep(connection.busy_until - self._now())
        if acknowledge:
            self._feed("move", fields, flags)
        else:
            connection.exchange.send("move", fields, flags | FLAG_NO_ACK)
            connection.exchange.listen(0)
            connection.raise_unasked("move")
        connection.busy_until = self._now() + duration_ms * 1e-3

    def stream(self, period: float = 0.05, early: float = EARLY) -> Stream:
        """Begin to stream commands at a fixed rate; see `Stream`. The hand is armed and at rest.

        Args:
            period: time between two commands, 0.02 to 1 [s].
            early: longest time by which a frame may come earlier, after another one, than it was
                sent after it [s].

        Raises:
            FrameError: `period` or `early` is out of bounds.
        """
        return Stream(self, period, early)

    def within_table(self, servo: Array) -> Array:
        """Servo angles, shape (6,) [rad]; on a board that was flashed for the nominal hand, those
        of another hand are clipped to its range, and the first that is clipped is told.
        """
        table = self._table
        if table is self._hand:
            return np.asarray(servo)
        clipped = np.clip(servo, table.servo_min, table.servo_max)
        beyond = np.abs(clipped - servo) > ANGLE_UNIT / 2
        if beyond.any() and not self._told_clipped:
            self._told_clipped = True
            worst = int(np.argmax(np.abs(clipped - servo)))
            warnings.warn(
                f"servo {SERVOS[worst]}: {servo[worst]:.4f} rad is clipped to {clipped[worst]:.4f} rad, the bound of the "
                f"board, which was flashed for '{table.name}' and not for '{self._hand.name}'",
                ClippedWarning,
                stacklevel=4,
            )
        return clipped

    @property
    def exchange(self) -> Exchange:
        """The exchange of frames of the present connection."""
        return self._connected().exchange

    @property
    def rate_limit(self) -> Array:
        """Rate limit of the servos by the board's table, shape (6,) [rad/s]."""
        return self._table.servo_rate_limit

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

    @turn
    def wait(self) -> HandStatus:
        """Wait until the hand reports that the move has ended.

        Raises:
            FaultError: A fault latched in the meantime.
            LinkTimeout: The hand still reports motion long after the move's duration.
        """
        self.sleep(self._connected().busy_until - self._now())
        deadline = self._now() + 1.0
        while (status := self.status()).moving:
            if self._now() > deadline:
                raise LinkTimeout("the hand still moves 1 s after the move should have ended")
            self.sleep(1e-3)
        return status

    @turn
    def sleep(self, seconds: float) -> None:
        """Wait, sending heartbeats while armed; returns at once for `seconds` ≤ 0.

        Raises:
            FaultError: A fault latched in the meantime.
            LinkTimeout, PortError: A heartbeat got no answer; the port is gone.
        """
        connection = self._connected()
        deadline = self._now() + seconds
        was_armed = connection.known.armed
        period = connection.watchdog / _HEARTBEATS_PER_WATCHDOG
        while (left := deadline - self._now()) > 0:
            due = connection.fed_at + period
            connection.exchange.listen(
                min(left, max(due - self._now(), 0.0)) if was_armed else left
            )
            if was_armed and self._now() >= due:
                self.heartbeat()
            if was_armed:
                connection.raise_unasked("it latched while waiting")

    @turn
    def heartbeat(self) -> str:
        """Send a heartbeat; returns the hand's state, a name of `protocol.State`."""
        self._feed("heartbeat")
        return self.state

    def _now(self) -> float:
        return self._connected().exchange.transport.now()

    def _feed(self, name: str, fields: Fields | None = None, flags: int = 0) -> None:
        """Send a message that feeds the hand's watchdog."""
        connection = self._connected()
        sent_at = self._now()
        connection.request(name, fields, flags)
        connection.fed_at = sent_at
