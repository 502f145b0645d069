"""Sweeps the servos of a connected hand, one at a time in both directions, at the hand's own pace."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from hpac_gym.bridge import HandLink
from hpac_gym.bridge.link import go, open_hand, release
from hpac_gym.calibration.record import CLEARED, EXTENDING, FLEXING, REST, Protocol, rest_pose
from hpac_gym.calibration.segment import Segment
from hpac_gym.camera.detection import Seen
from hpac_gym.model import HPAC, SERVO_INDEX, Hand, ServoCommand, move_duration

PROTOCOL = Protocol(both_directions=True)
RATE_HZ = 20.0
"""Samples of a record [Hz]."""
WATCHDOG = 1.0
"""Longest silence before the hand relaxes by itself: a camera may block for a while [s]."""
SETTLED = 0.2
"""Part of a hold that does not count: the digit comes to rest, and pictures are a little old [s]."""
OUT_OF_SIGHT = {"middle_mcp": "index_mcp", "ring_mcp": "pinky_mcp"}
"""Finger that is flexed all the while, since it would hide the tags of the swept one."""
Look = Callable[[], Seen | None]
"""The tags in the newest picture; None: there is none since the last call."""


class Driver:
    """Sweeps the servos of a connected hand.

    Args:
        link: connected, not armed.
        look: what sees the tags.
        hand: the hand, over whose range is swept.
        protocol: the sweep.
        rate_hz: samples of the record [Hz].
    """

    def __init__(
        self,
        link: HandLink,
        look: Look,
        hand: Hand = HPAC,
        protocol: Protocol = PROTOCOL,
        rate_hz: float = RATE_HZ,
    ) -> None:
        self._link = link
        self._look = look
        self._hand = hand
        self._protocol = protocol
        self._period = 1.0 / rate_hz
        self._now = link.exchange.transport.now

    def sweep(self, segment: Segment) -> None:
        """Sweep one servo; the samples go into the segment as they come. Afterwards, and after every
        error, the hand is open and disarmed.

        At rest the hand has no pulses, so that the springs pull the digit against its stops; only the
        thumb's CMC has to hold the thumb while its MP rests.

        Raises:
            BridgeError: The hand refuses, is stopped, or does not answer.
            CameraError: There are no more pictures.
        """
        try:
            self._sweep(segment)
        except BaseException as error:
            release(self._link, error)
            raise

    def _sweep(self, segment: Segment) -> None:
        swept = SERVO_INDEX[segment.servo]
        holds = rest_pose(segment.servo, self._hand)
        held = segment.servo == CLEARED
        angles = np.linspace(
            self._hand.servo_min[swept], self._hand.servo_max[swept], self._protocol.points
        )
        pose = holds.copy()
        if other := OUT_OF_SIGHT.get(segment.servo):
            pose[SERVO_INDEX[other]] = self._hand.servo_max[SERVO_INDEX[other]]
        self._segment = segment
        self._next = 0
        self._begun = self._now()
        if held:
            with self._clock_stands():
                self._link.arm(watchdog=WATCHDOG)
                go(self._link, holds)
        self._watch(self._protocol.rest, REST)
        with self._clock_stands():
            if not held:
                self._link.arm(watchdog=WATCHDOG)
            go(self._link, pose)
        there = list(enumerate(angles))
        back = there[::-1] if self._protocol.both_directions else [(-1, angles[0])]
        for phase, course in ((FLEXING, there), (EXTENDING, back)):
            for point, angle in course:
                target = pose.copy()
                target[swept] = angle
                least = move_duration(self._link.status().servo, target, self._hand)
                moving = max(self._protocol.seconds_per_point - self._protocol.hold, 2.0 * least)
                self._link.move(ServoCommand(target, moving), minimum_jerk=True)
                self._watch(moving + SETTLED, phase)
                self._watch(self._protocol.hold - SETTLED, phase, point)
        with self._clock_stands():
            if held:
                go(self._link, holds)
            else:
                open_hand(self._link)
                self._link.clear()
                self._link.sleep(0.5)
        self._watch(self._protocol.rest, REST)
        open_hand(self._link)
        self._link.clear()

    def _watch(self, seconds: float, phase: int, point: int = -1) -> None:
        """Take samples for some time."""
        for _ in range(round(seconds / self._period)):
            self._link.sleep(self._begun + self._next * self._period - self._now())
            status = self._link.status()
            # Of samples that come too late some are left out: the others stay evenly spaced.
            self._next = max(self._next, int((self._now() - self._begun) / self._period))
            segment = self._segment
            segment.seen.append(self._look() or {})
            segment.labels.append((phase, point))
            segment.commanded.append(
                rest_pose(segment.servo, self._hand) if phase == REST else status.servo
            )
            segment.unix.append(time.time())
            segment.time.append(self._next * self._period)
            self._next += 1

    @contextmanager
    def _clock_stands(self) -> Iterator[None]:
        """The record's clock stands still while the hand is armed or disarmed."""
        before = self._now()
        yield
        self._begun += self._now() - before
