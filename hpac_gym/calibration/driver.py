"""Sweeps one servo of a connected hand in both directions, at the hand's own pace, and keeps the samples,
to which a camera or another program gives angles.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from hpac_gym.bridge import HandLink
from hpac_gym.bridge.link import go, open_hand, release
from hpac_gym.calibration.judging import point_medians
from hpac_gym.calibration.record import (
    CLEARED,
    EXTENDING,
    FLEXING,
    REST,
    Protocol,
    Sweep,
    rest_pose,
)
from hpac_gym.camera.angles import turns
from hpac_gym.camera.detection import Lens, Seen
from hpac_gym.camera.sheet import CHAINS, STRIPS
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVO_INDEX,
    SERVOS,
    Hand,
    ServoCommand,
    elastic_joints_from_servo,
    move_duration,
)
from hpac_gym.model.checks import Array

PROTOCOL = Protocol(both_directions=True)
RATE_HZ = 20.0
"""Samples of a record [Hz]."""
WATCHDOG = 1.0
"""Longest silence before the hand relaxes by itself: a camera may block for a while [s]."""
SETTLED = 0.2
"""Part of a hold that does not count: the digit comes to rest, and pictures are a little old [s]."""
OUT_OF_SIGHT = {"middle_mcp": "index_mcp", "ring_mcp": "pinky_mcp"}
"""Finger that is flexed all the while, since it would hide the tags of the swept one."""
FLEXED = 0.05
"""Least angle of a joint that has surely begun to flex (chosen) [rad]."""
Look = Callable[[], Seen]
"""The tags in the newest picture; none of them, if there is no picture since the last call."""


@dataclass(slots=True)
class Segment:
    """The samples of one sweep of one servo, as they come."""

    servo: str
    trial: int = 0
    labels: list[tuple[int, int]] = field(default_factory=list)
    """Phase and point."""
    time: list[float] = field(default_factory=list)
    """[s]; it stands still while the hand is armed."""
    unix: list[float] = field(default_factory=list)
    """Time of the day of each sample, since 1970 [s]."""
    commanded: list[Array] = field(default_factory=list)
    seen: list[Seen] = field(default_factory=list)
    joint_pos: Array | None = None
    """Shape (samples, 15) [rad]; None: not known yet."""

    def sweep(self) -> Sweep:
        """The record; angles that are not known are empty."""
        count = len(self.time)
        phase, point = np.array(self.labels, dtype=int).reshape(-1, 2).T
        unknown = np.full((count, len(JOINTS)), np.nan)
        return Sweep(
            np.full(count, self.trial),
            np.full(count, SERVO_INDEX[self.servo]),
            phase,
            point,
            np.array(self.time),
            np.array(self.commanded).reshape(-1, len(SERVOS)),
            unknown if self.joint_pos is None else self.joint_pos,
        )

    def angles_from_tags(self, lens: Lens) -> float:
        """Find the joint angles, and return the misfit of the tags [pixels].

        Raises:
            CameraError: As of `turns`.
        """
        # Only before the sweep is the digit surely at its stops: friction may hold it back afterwards.
        at_rest = np.logical_and.accumulate([phase == REST for phase, _ in self.labels])
        angles, misfit = turns(self.seen, STRIPS[self.servo], lens, at_rest)
        self.joint_pos = np.full((len(self.time), len(JOINTS)), np.nan)
        self.joint_pos[:, [JOINT_INDEX[name] for name in CHAINS[self.servo][1:]]] = angles
        return misfit

    def slack(self, hand: Hand) -> float:
        """Servo angle at which the swept joint begins to flex, extrapolated from the first two points
        where it has flexed, along the design's curve [rad]; infinite without two.

        About 0, the tendon may have been taut at rest already. How far it had then moved the joints is
        in no picture: a constant shift of the angles fits as well as none.
        """
        swept = SERVO_INDEX[self.servo]
        joint = JOINT_INDEX[self.servo]
        record = self.sweep()
        held = (record.phase == FLEXING) & (record.point >= 0)
        held &= ~np.isnan(record.joint_pos[:, joint])
        if not held.any():
            return np.inf
        servo, medians, _ = point_medians(record, np.flatnonzero(held))
        flexed = np.flatnonzero(medians[:, joint] > FLEXED)[:2]
        if len(flexed) < 2:
            return np.inf
        first, second = servo[flexed, swept]
        course = np.zeros((200, len(SERVOS)))
        course[:, swept] = np.linspace(hand.servo_min[swept], hand.servo_max[swept], len(course))
        angles = elastic_joints_from_servo(course, hand)[:, joint]
        near, far = np.interp(medians[flexed, joint], angles, course[:, swept])
        return float(first - near * (second - first) / (far - near))


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
