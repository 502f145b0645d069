"""The link to one hand: handshake, arming, moves, heartbeat, e-stop. One thread, and no call blocks for ever."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from time import monotonic, sleep

import numpy as np

from hpac_gym.bridge.errors import BridgeError, HandshakeError, LinkTimeout, PortError
from hpac_gym.bridge.exchange import Exchange
from hpac_gym.bridge.frame import FrameSplitter
from hpac_gym.bridge.known_state import KnownState
from hpac_gym.bridge.limits import limits_hash
from hpac_gym.bridge.protocol import (
    ANGLE_UNIT,
    CONSTANTS,
    FLAG_MINIMUM_JERK,
    FLAG_NO_ACK,
    VERSION,
    Action,
    Fault,
    Reason,
)
from hpac_gym.bridge.reports import HandInfo, HandStatus
from hpac_gym.bridge.statistics import LinkStatistics
from hpac_gym.bridge.transport import Transport, open_transport
from hpac_gym.bridge.wire_log import WireLog
from hpac_gym.model import HPAC, SERVOS, Hand, ServoCommand

_HELLO_PERIOD = 0.1
_HEARTBEATS_PER_WATCHDOG = 4


class HandLink:
    """A hand at the other end of a wire; connects on entry, disarms and closes on exit.

    ```python
    with HandLink("/dev/ttyUSB0") as link:
        link.arm()
        for command in commands:      # one every command.duration: move() waits for the one before to end
            link.move(command)
        link.wait()
    ```
    There is no hidden thread: a program that hangs falls silent, and after `info.watchdog` the hand does what `arm` was
    told. Use `sleep` instead of `time.sleep` while armed; it sends heartbeats. Not to be shared between threads.

    Args:
        port: name of a port (see `open_transport`), or a function that opens a transport, `VirtualHand.connect` say.
        hand: whose limits the firmware must have been built with.
        timeout: patience with one answer [s].
        attempts: how often a frame is sent before `LinkTimeout`.
        handshake_timeout: patience with HELLO [s]; boards that reset when the port opens need 1 to 2 s.
        log: gets every frame.

    Attributes:
        info: the hand's answer to HELLO.
        statistics: counters and round trips.
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
        self._limits_hash = limits_hash(hand)
        self._patience = {"timeout": timeout, "attempts": attempts}
        self._handshake_timeout = handshake_timeout
        self._log = log
        self._exchange: Exchange | None = None
        self._busy_until = 0.0
        self._heard_at = 0.0
        self._known = KnownState()
        self.info: HandInfo | None = None
        self.statistics = LinkStatistics()

    @property
    def state(self) -> str:
        """The hand's last known state, of `protocol.State`."""
        return self._known.state

    @property
    def last_status(self) -> HandStatus | None:
        """The latest STATUS, asked for or periodic."""
        return self._known.status

    def __enter__(self) -> HandLink:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def connect(self) -> HandInfo:
        """Open the port and greet the hand. Afterwards it is not armed, whatever it was before.

        Raises:
            PortError: The port cannot be opened.
            HandshakeError: Nothing answers, or a firmware of another protocol version.
        """
        self._drop()
        self._exchange = Exchange(self._open(), self.statistics, self._known.take_in, self._log)
        attempts = max(1, math.ceil(self._handshake_timeout / _HELLO_PERIOD))
        try:
            answer = self._exchange.request("hello", timeout=_HELLO_PERIOD, attempts=attempts)
        except LinkTimeout:
            error = _handshake_error(self._exchange.splitter, self._handshake_timeout)
            self._drop()
            raise error from None
        except PortError:
            self._drop()
            raise
        self.info = HandInfo.from_frame(answer)
        self._busy_until = 0.0
        self.statistics.connections += 1
        self.statistics.acked += 1
        return self.info

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

    def close(self) -> None:
        """Disarm the hand if it can be reached, and let the port go. Raises nothing, may be called twice."""
        if self._exchange is not None and self._known.armed:
            with suppress(BridgeError):
                self.clear()
        self._drop()

    def arm(self, action: Action = Action.relax) -> None:
        """Arm the hand and wait until all servos get pulses, one after the other, at rest.

        Args:
            action: what the hand does when this program falls silent for `info.watchdog`.

        Raises:
            HandshakeError: The firmware was built with other limits than those of `hand`.
            RejectedError: Not in IDLE, or a servo is too hot. FaultError: a fault must be cleared first.
            LinkTimeout: No answer, or not all servos got pulses.
        """
        if self.info is not None and self.info.limits_hash != self._limits_hash:
            raise HandshakeError(
                f"the firmware's servo limits {self.info.limits_hash:08x} are not this hand's {self._limits_hash:08x}: "
                "generate, build and flash the firmware for this hand"
            )
        self._request("arm", {"limits_hash": self._limits_hash, "action": int(action)})
        deadline = self._now() + 2 * len(SERVOS) * CONSTANTS["stagger_ms"] * 1e-3
        while len(self.status().attached) < len(SERVOS):
            if self._now() > deadline:
                raise LinkTimeout(f"only {', '.join(self.last_status.attached)} got pulses")
            self.sleep(CONSTANTS["stagger_ms"] * 0.25e-3)
        self._busy_until = self._now()

    def move(self, command: ServoCommand, *, minimum_jerk: bool = False, acknowledge: bool = True, pace: bool = True) -> None:
        """Send one synchronised move, and wait for the hand's ACK.

        The duration goes out in whole ms, rounded up, so that no move gets faster; angles in 1e-4 rad.

        Args:
            minimum_jerk: a smooth move from the present pose and velocity, instead of a linear one from the pose.
            acknowledge: False asks for no ACK and does not wait; a refusal then shows in the next answer's counters.
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
            self._request("move", fields, flags)
        else:
            self._connected().send("move", fields, flags | FLAG_NO_ACK)
        self._busy_until = self._now() + duration_ms * 1e-3

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

    def sleep(self, seconds: float) -> None:
        """Let time pass, with heartbeats while armed; returns at once for `seconds` ≤ 0.

        Raises:
            FaultError: A fault latched meanwhile.
            LinkTimeout, PortError: A heartbeat got no answer; the port has gone.
        """
        deadline = self._now() + seconds
        was_armed = self._known.armed
        period = (self.info.watchdog if self.info else 1.0) / _HEARTBEATS_PER_WATCHDOG
        while (left := deadline - self._now()) > 0:
            due = self._heard_at + period
            self._connected().listen(min(left, max(due - self._now(), 0.0)) if was_armed else left)
            if was_armed and self._now() >= due:
                self.heartbeat()
            if was_armed and self._known.in_fault:
                self._learn_fault()
                raise self._known.fault_error("it latched while waiting")

    def heartbeat(self) -> str:
        """Tell the hand that this program is alive; returns the hand's state, of `protocol.State`."""
        self._request("heartbeat")
        return self.state

    def estop(self) -> None:
        """Stop all pulses now and latch a fault, in any state."""
        self._request("estop")

    def clear(self) -> None:
        """Disarm, or leave a latched fault: no motion, no pulses, state IDLE.

        Raises:
            RejectedError: The fault cannot be cleared: the board's own servo table is unusable.
        """
        self._request("clear")

    def status(self, period: float = 0.0) -> HandStatus:
        """Ask what the hand does; from now on it also says so by itself every `period` [s], or not at all for 0.

        Raises:
            RejectedError: A period below 10 ms.
        """
        self._request("status", {"period_ms": round(period * 1e3)})
        return self.last_status

    # --- below: one frame at a time -------------------------------------------------------------------------------

    def _connected(self) -> Exchange:
        if self._exchange is None:
            raise PortError("not connected")
        return self._exchange

    def _now(self) -> float:
        return self._connected().transport.now()

    def _drop(self) -> None:
        if self._exchange is not None:
            self.statistics.bad_frames += self._exchange.splitter.rejected_frames
            self.statistics.bad_bytes += self._exchange.splitter.rejected_bytes
            self._exchange.transport.close()
        self._exchange = None
        self._known.forget()

    def _request(self, name: str, fields: dict | None = None, flags: int = 0) -> None:
        answer = self._connected().request(name, fields, flags, **self._patience)
        if answer.name == "ack" and answer.fields["reason"] != Reason.ok:
            self.statistics.rejected += 1
            self._learn_fault()
            raise self._known.refusal(name, answer)
        self.statistics.acked += 1
        self._heard_at = self._now()

    def _learn_fault(self) -> None:
        """Ask which fault it is if the frame that told of it was lost."""
        if self._known.in_fault and self._known.fault == Fault.none.name:
            with suppress(BridgeError):
                self._connected().request("status", {"period_ms": 0}, **self._patience)


def _handshake_error(heard: FrameSplitter, patience: float) -> HandshakeError:
    """Why nobody answered HELLO, as far as what was heard tells."""
    if heard.other_version is not None:
        return HandshakeError(f"the hand speaks protocol {heard.other_version}, this library {VERSION}: update one of them")
    what = f"{heard.rejected_bytes} bytes came that were no frame" if heard.rejected_bytes else "silence"
    return HandshakeError(f"no hand answered within {patience:g} s ({what})")
