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
Look = Callable[[], Seen]
"""The tags in the newest picture; none of them, if there is no picture since the last call."""


def sweep_servo(
    link: HandLink,
    look: Look,
    segment: Segment,
    hand: Hand = HPAC,
    protocol: Protocol = PROTOCOL,
    rate_hz: float = RATE_HZ,
) -> None:
    """Sweep one servo; the samples go into the segment as they come. Afterwards, and after every error,
    the hand is open and disarmed.

    At rest the hand has no pulses, so that the springs pull the digit against its stops; only the
    thumb's CMC has to hold the thumb while its MP rests.

    Args:
        link: connected, not armed.
        look: what sees the tags.
        segment: an empty one of the servo.
        hand: the hand, over whose range is swept.
        protocol: points and times; the points are taken in both directions.
        rate_hz: samples of the record [Hz].

    Raises:
        BridgeError: The hand refuses, is stopped, or does not answer.
        CameraError: There are no more pictures.
    """
    try:
        _sweep(link, look, segment, hand, protocol, 1.0 / rate_hz)
    except BaseException as error:
        release(link, error)
        raise


def _sweep(
    link: HandLink, look: Look, segment: Segment, hand: Hand, protocol: Protocol, period: float
) -> None:
    now = link.exchange.transport.now
    begun = now()
    taken = 0

    @contextmanager
    def clock_stands() -> Iterator[None]:
        """The record's clock stands still while the hand is armed or disarmed."""
        nonlocal begun
        before = now()
        yield
        begun += now() - before

    def watch(seconds: float, phase: int, point: int = -1) -> None:
        """Take samples for some time."""
        nonlocal taken
        for _ in range(round(seconds / period)):
            link.sleep(begun + taken * period - now())
            status = link.status()
            # Of samples that come too late some are left out: the others stay evenly spaced.
            taken = max(taken, int((now() - begun) / period))
            segment.seen.append(look())
            segment.labels.append((phase, point))
            segment.commanded.append(holds if phase == REST else status.servo)
            segment.unix.append(time.time())
            segment.time.append(taken * period)
            taken += 1

    swept = SERVO_INDEX[segment.servo]
    holds = rest_pose(segment.servo, hand)
    held = segment.servo == CLEARED
    angles = np.linspace(hand.servo_min[swept], hand.servo_max[swept], protocol.points)
    pose = holds.copy()
    if other := OUT_OF_SIGHT.get(segment.servo):
        pose[SERVO_INDEX[other]] = hand.servo_max[SERVO_INDEX[other]]
    if held:
        with clock_stands():
            link.arm(watchdog=WATCHDOG)
            go(link, holds)
    watch(protocol.rest, REST)
    with clock_stands():
        if not held:
            link.arm(watchdog=WATCHDOG)
        go(link, pose)
    points = list(enumerate(angles))
    for phase, course in ((FLEXING, points), (EXTENDING, points[::-1])):
        for point, angle in course:
            target = pose.copy()
            target[swept] = angle
            least = move_duration(link.status().servo, target, hand)
            moving = max(protocol.seconds_per_point - protocol.hold, 2.0 * least)
            link.move(ServoCommand(target, moving), minimum_jerk=True)
            watch(moving + SETTLED, phase)
            watch(protocol.hold - SETTLED, phase, point)
    with clock_stands():
        if held:
            go(link, holds)
        else:
            open_hand(link)
            link.clear()
            link.sleep(0.5)
    watch(protocol.rest, REST)
    open_hand(link)
    link.clear()
