"""The link to one hand: arming, moves, heartbeat; on closing it leaves the hand without pulses. And
slow moves of an armed hand: to where a program begins, and open at its end, whatever happened.
"""

import math
from contextlib import suppress

import numpy as np

from hpac_gym.bridge.errors import BridgeError, FaultError, FrameError, LinkTimeout, PortError
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.bridge.line import Line, milliseconds, turn
from hpac_gym.bridge.protocol import ANGLE_UNIT, CONSTANTS, FLAG_MINIMUM_JERK, Action, Fields
from hpac_gym.bridge.reports import HandStatus
from hpac_gym.bridge.stream import EARLY, Stream
from hpac_gym.model import SERVOS, ServoCommand, move_duration
from hpac_gym.model.checks import Array

_ARM_POLL = 0.05
_STEP_MAX = 0x7FFF
_HEARTBEATS_PER_WATCHDOG = 4
GENTLE = 0.25
"""Share of the rate limit at which a hand goes to its start posture and opens."""


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
        self.board.built_for = info.table_of(self.board.hand)
        connection.known.limits = servo_limits(self.board.built_for)
        fields = {
            "limits_hash": info.limits_hash,
            "watchdog_ms": milliseconds("watchdog", watchdog),
            "action": int(Action(action)),
        }
        self._feed("arm", fields)
        connection.watchdog = watchdog
        hand = self.board.built_for  # whose servos, if they hold without power, may go all the way
        way = move_duration(hand.servo_min, hand.servo_max, hand) / CONSTANTS["relax_permille"]
        patience = CONSTANTS["start_max_ms"] * 1e-3 + 1e3 * way
        deadline = max(self._now(), connection.busy_until) + patience
        while len((status := self.status()).attached) < len(SERVOS) or status.moving:
            connection.raise_unasked("it latched while arming")
            if self._now() > deadline:
                raise LinkTimeout(f"after {patience:g} s pulses at {status.attached} alone")
            self.sleep(_ARM_POLL)
        connection.busy_until = self._now()

    @turn
    def move(
        self,
        command: ServoCommand,
        *,
        minimum_jerk: bool = False,
        pace: bool = True,
    ) -> None:
        """Send one synchronised move, and wait for the hand's ACK.

        The duration is sent in whole ms, rounded up, so that no move gets faster; angles in units
        of 1e-4 rad.

        Args:
            minimum_jerk: a smooth move from the present pose and velocity, instead of a linear one
                from the pose.
            pace: first wait until the previous move has ended. False pre-empts it.

        Raises:
            FrameError: An angle beyond ±3.2767 rad, or a duration beyond 65.535 s.
            RejectedError: Outside the limits, too fast, or not armed. FaultError: a fault is
                latched.
            LinkTimeout, PortError: No answer; the port is gone.
        """
        duration_ms = milliseconds("duration", command.duration)
        steps = np.rint(self.board.within(command.servo) / ANGLE_UNIT).astype(int)
        if np.abs(steps).max() > _STEP_MAX:
            worst = max(command.servo, key=abs)
            raise FrameError(
                f"a servo angle of {worst:g} rad, allowed ±{_STEP_MAX * ANGLE_UNIT:g} rad"
            )
        fields: Fields = {"duration_ms": duration_ms, "servo": tuple(steps.tolist())}
        connection = self._connected()
        if pace:
            self.sleep(connection.busy_until - self._now())
        self._feed("move", fields, FLAG_MINIMUM_JERK if minimum_jerk else 0)
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

    @turn
    def wait(self) -> HandStatus:
        """Wait until the hand reports that the move has ended.

        Raises:
            FaultError: A fault latched in the meantime.
            LinkTimeout: The hand still reports motion long after the move's duration.
        """
        connection = self._connected()
        was_armed = connection.known.state == "armed"
        self.sleep(connection.busy_until - self._now())
        deadline = self._now() + 1.0
        while True:
            status = self.status()
            if was_armed:
                connection.raise_unasked("it latched while waiting")
            if not status.moving:
                return status
            if self._now() > deadline:
                raise LinkTimeout("the hand still moves 1 s after the move should have ended")
            self.sleep(1e-3)

    @turn
    def sleep(self, seconds: float) -> None:
        """Wait, sending heartbeats while armed; returns at once for `seconds` ≤ 0.

        Raises:
            FaultError: A fault latched in the meantime.
            LinkTimeout, PortError: A heartbeat got no answer; the port is gone.
        """
        connection = self._connected()
        deadline = self._now() + seconds
        was_armed = connection.known.state == "armed"
        period = connection.watchdog / _HEARTBEATS_PER_WATCHDOG if was_armed else math.inf
        while (left := deadline - self._now()) > 0:
            due = connection.fed_at + period
            connection.exchange.listen(min(left, max(due - self._now(), 0.0)))
            if self._now() >= due:
                self.heartbeat()
            if was_armed:
                connection.raise_unasked("it latched while waiting")

    @turn
    def heartbeat(self) -> str:
        """Send a heartbeat; returns the hand's state, a name of `protocol.State`."""
        self._feed("heartbeat")
        return self.state

    def _feed(self, name: str, fields: Fields | None = None, flags: int = 0) -> None:
        """Send a message that feeds the hand's watchdog."""
        connection = self._connected()
        sent_at = self._now()
        connection.request(name, fields, flags)
        connection.fed_at = sent_at


def go(link: HandLink, servo: Array) -> None:
    """Move slowly to servo angles, shape (6,) [rad], and wait until they are reached. Errors as of
    `HandLink.move`.
    """
    start = link.status().servo
    duration = move_duration(start, servo, link.board.built_for) / GENTLE + 0.05
    moves = math.ceil(1e3 * duration / CONSTANTS["move_max_ms"])
    for share in np.linspace(0.0, 1.0, moves + 1)[1:]:
        link.move(ServoCommand(start + share * (servo - start), duration / moves))
    link.wait()


def open_hand(link: HandLink) -> None:
    """Open slowly, from wherever the hand is, if it is armed. Errors as of `HandLink.move`."""
    link.exchange.on_ack = None
    link.exchange.refused = None
    state = link.status().state
    link.listen(0.0, "not opened")  # a fault is told, and not cleared by who disarms next
    if state == "armed":
        hand = link.board.built_for
        go(link, np.clip(0.0, hand.servo_min, hand.servo_max))


def release(link: HandLink, error: BaseException) -> None:
    """After an error: open the hand slowly where it still follows, and disarm it; raises nothing of
    the link.
    """
    with suppress(BridgeError):
        if not isinstance(error, FaultError):
            open_hand(link)
    with suppress(BridgeError):
        if link.state == "armed":
            link.clear()
