"""The driving part of ``hpac sweep --port``: a hand is swept at its own pace, one servo at a time in
both directions, and watched: by a camera that sees the tags of ``hpac tags``, or by another program.

Whatever happens, the hand is opened and disarmed, and what was recorded is kept."""

import csv
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hpac_gym.bridge import HandLink
from hpac_gym.bridge.commands import connector
from hpac_gym.bridge.gentle import go, open_hand, release
from hpac_gym.calibration.protocol import Protocol, rest_pose
from hpac_gym.calibration.record import (
    EXTENDING,
    FLEXING,
    JOINT_COLUMNS,
    REST,
    RecordError,
    Sweep,
    concatenate,
    read_sweep,
    write_sweep,
)
from hpac_gym.camera import CameraError
from hpac_gym.camera.angles import turns
from hpac_gym.camera.detection import Device, Lens, Seen, Watch, detect, lens_of
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
from hpac_gym.output import writable_file

PROTOCOL = Protocol(both_directions=True)
RATE_HZ = 20.0
"""Samples of a record [Hz]."""
WATCHDOG = 1.0
"""Longest silence before the hand relaxes by itself: a camera may block for a while [s]."""
SETTLED = 0.2
"""Part of a hold that does not count: the digit comes to rest, and pictures are a little old [s]."""
OLDEST = 1.0
"""Age of the last picture at which a sweep is given up [s]."""
PATIENCE = 5.0
"""Time for which a strip is looked for before the hand moves [s]."""
APART = 0.1
"""Longest time between an angle of another program and the sample that takes it [s]."""
OUT_OF_SIGHT = {"middle_mcp": "index_mcp", "ring_mcp": "pinky_mcp"}
"""Finger that is flexed all the while, since it would hide the tags of the swept one."""
SIDES = {
    "thumb_mp": "along the axis of the thumb's MP joint, the thumb being in front of the palm",
    "index_mcp": "from the thumb's side",
    "middle_mcp": "from the thumb's side",
    "ring_mcp": "from the little finger's side",
    "pinky_mcp": "from the little finger's side",
    "thumb_cmc": "along the axis of the thumb's CMC joint",
}
"""From where the camera looks."""

FLEXED = 0.05
"""Least angle of a joint that has surely begun to flex (chosen) [rad]."""
TAUT = (
    "{}: it flexes from command 0 on. If its tendon is taut there, all its angles are off by a constant, "
    "which no camera sees: set the horn back by a tooth, and sweep again"
)
LEAST_SLACK = np.radians(0.3)
"""Slack, as an angle of the servo, below which a tendon may have been taut at rest (chosen): it is
known to 0.1° with 31 points, to 0.3° with 13 [rad].
"""

Look = Callable[[], Seen | None]
"""The tags in the newest picture; None: there is none since the last call."""


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
        turned = turns(self.seen, STRIPS[self.servo], lens, at_rest)
        self.joint_pos = np.full((len(self.time), len(JOINTS)), np.nan)
        self.joint_pos[:, [JOINT_INDEX[name] for name in CHAINS[self.servo][1:]]] = turned.joint_pos
        return turned.misfit

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
        means = [
            (record.servo[rows, swept].mean(), np.nanmedian(record.joint_pos[rows, joint]))
            for rows in (held & (record.point == point) for point in np.unique(record.point[held]))
        ]
        flexed = [mean for mean in means if mean[1] > FLEXED]
        if len(flexed) < 2:
            return np.inf
        (first, second), seen = np.transpose(flexed[:2])
        course = np.zeros((200, len(SERVOS)))
        course[:, swept] = np.linspace(hand.servo_min[swept], hand.servo_max[swept], len(course))
        angles = elastic_joints_from_servo(course, hand)[:, joint]
        near, far = np.interp(seen, angles, course[:, swept])
        return float(first - near * (second - first) / (far - near))


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
        holds = rest_pose(segment.servo)
        held = holds.any()
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
        points = list(enumerate(angles))
        both = self._protocol.both_directions
        for phase, course in ((FLEXING, points), (EXTENDING, points[::-1] if both else points[:1])):
            for point, angle in course:
                target = pose.copy()
                target[swept] = angle
                least = move_duration(self._link.status().servo, target, self._hand)
                moving = max(self._protocol.seconds_per_point - self._protocol.hold, 2.0 * least)
                self._link.move(ServoCommand(target, moving), minimum_jerk=True)
                self._watch(moving + SETTLED, phase)
                counts = both or phase == FLEXING
                self._watch(self._protocol.hold - SETTLED, phase, point if counts else -1)
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
            segment.commanded.append(rest_pose(segment.servo) if phase == REST else status.servo)
            segment.unix.append(time.time())
            segment.time.append(self._next * self._period)
            self._next += 1

    @contextmanager
    def _clock_stands(self) -> Iterator[None]:
        """The record's clock stands still while the hand is armed or disarmed."""
        before = self._now()
        yield
        self._begun += self._now() - before


class Eye:
    """The tags in the newest picture of a watch, each picture once.

    Raises:
        CameraError: On a call: the last picture is older than `OLDEST`.
    """

    def __init__(self, watch: Watch[Seen]) -> None:
        self._watch = watch
        self._last: Seen | None = None

    def __call__(self) -> Seen | None:
        latest = self._watch.latest()
        if latest is None or latest[1] > OLDEST:
            raise CameraError(f"no picture for {OLDEST:g} s: {self._watch.fault or 'it hangs'}")
        if latest[0] is self._last:
            return None
        self._last = latest[0]
        return self._last

    def wait_for(self, servo: str, patience: float = PATIENCE) -> None:
        """Wait until all tags of a strip are seen.

        Raises:
            CameraError: Some are not, after `patience` [s].
        """
        deadline = time.monotonic() + patience
        while True:
            latest = self._watch.latest()
            seen = latest[0] if latest is not None and latest[1] < OLDEST else {}
            missing = [f"{tag.id} ({tag.label})" for tag in STRIPS[servo] if tag.id not in seen]
            if not missing:
                return
            if time.monotonic() > deadline:
                raise CameraError(
                    f"sweep of {servo}: not seen: tag {', '.join(missing)} {self._watch.fault}".strip()
                )
            time.sleep(0.02)


def joined(segments: Sequence[Segment], path: Path) -> None:
    """Give segments the angles that another program wrote, by the time of the day.

    Args:
        segments: get their `joint_pos`.
        path: a CSV file with the columns ``time_s``, seconds since 1970, and any of
            ``joint_{name}_rad``.

    Raises:
        RecordError: The file cannot be read, or has no such columns, or a time goes back.
    """
    try:
        rows = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise RecordError(f"angles {path}: {reason}") from None
    names = [name for name in JOINT_COLUMNS if rows and name in rows[0]]
    if not names or "time_s" not in rows[0]:
        raise RecordError(
            f"angles {path}: no rows with time_s and any of {', '.join(JOINT_COLUMNS[:2])} …"
        )
    try:
        at = np.array([float(row["time_s"]) for row in rows])
        angles = np.array([[float(row[name] or "nan") for name in names] for row in rows])
    except (TypeError, ValueError) as error:
        raise RecordError(f"angles {path}: {error}") from None
    if not (np.diff(at) > 0).all() or np.nanmax(np.abs(angles), initial=0.0) > np.pi:
        raise RecordError(f"angles {path}: times must increase, and angles lie within ±π rad")
    for segment in segments:
        wanted = np.array(segment.unix)
        segment.joint_pos = np.full((len(wanted), len(JOINTS)), np.nan)
        for column, name in enumerate(names):
            known = ~np.isnan(angles[:, column])
            if not known.any():
                continue
            after = np.searchsorted(at[known], wanted).clip(1, max(known.sum() - 1, 1))
            near = np.minimum(
                *(np.abs(at[known][(after - i).clip(0, known.sum() - 1)] - wanted) for i in (0, 1))
            )
            angle = np.interp(wanted, at[known], angles[known, column])
            segment.joint_pos[:, JOINT_COLUMNS.index(name)] = np.where(near <= APART, angle, np.nan)


def added(path: Path, segments: Sequence[Segment]) -> Sweep:
    """The record of some segments, and of those in a file that are not among them.

    Raises:
        RecordError: The file is no record.
    """
    parts = [segment.sweep() for segment in segments if segment.time]
    new = {(segment.trial, SERVO_INDEX[segment.servo]) for segment in segments if segment.time}
    if path.exists():
        before = read_sweep(path)
        for rows in before.segments():
            if (int(before.trial[rows[0]]), int(before.swept[rows[0]])) not in new:
                parts.append(before[rows])
    return concatenate(parts)


def record(
    port: str,
    path: Path,
    *,
    camera: str | None = None,
    angles: Path | None = None,
    servos: Sequence[str] = SERVOS,
    trial: int = 0,
    points: int | None = None,
    hand: Hand = HPAC,
    ask: Callable[[str], object] | None = None,
) -> Sweep:
    """Sweep a hand, and write the record, which is also in the file after an error.

    Args:
        port: as of every command.
        path: the record; segments of other servos and trials that it has stay.
        camera: number of a camera, or a video, and with a comma its file.
        angles: file that another program writes meanwhile, see `joined`.
        servos: servos to sweep.
        trial: number of the repetition.
        points: sampling points of a servo; None: as many as `PROTOCOL` has.
        hand: the hand.
        ask: tells a person what to do, and waits; None: nobody is asked.

    Raises:
        CameraError, BridgeError, RecordError, OutputError: See there.
    """
    segments: list[Segment] = []
    writable_file(path)
    if path.exists():
        read_sweep(path)
    with ExitStack() as stack:
        look: Look = dict
        lens = Lens()
        if camera is not None:
            name, lens = lens_of(camera)

            def seen(picture: np.ndarray) -> Seen:
                lens.require(picture)
                return detect(picture)

            watch = Watch(Device(name, lens.size), seen)
            stack.callback(watch.close)
            look = Eye(watch)
        link = stack.enter_context(HandLink(connector(port, stack, hand), hand=hand))
        protocol = replace(PROTOCOL, points=points or PROTOCOL.points)
        driver = Driver(link, look, hand, protocol)
        try:
            for servo in servos:
                ids = ", ".join(f"{tag.id} {tag.label}" for tag in STRIPS[servo])
                if ask is not None and camera is not None:
                    ask(f"{servo}: tags {ids}; the camera looks {SIDES[servo]}. Enter sweeps it")
                if isinstance(look, Eye):
                    look.wait_for(servo)
                print(f"sweep of {servo}; Ctrl-C opens the hand", file=sys.stderr, flush=True)
                segments.append(Segment(servo, trial))
                driver.sweep(segments[-1])
                if isinstance(look, Eye):
                    try:
                        misfit = segments[-1].angles_from_tags(lens)
                    except CameraError as error:
                        raise CameraError(f"sweep of {servo}: {error}") from None
                    print(f"its tags fit to {misfit:.2f} pixels", file=sys.stderr, flush=True)
                    if rest_pose(servo).any() and segments[-1].slack(hand) < LEAST_SLACK:
                        print(TAUT.format(servo), file=sys.stderr, flush=True)
        finally:
            _keep(path, segments)
    if angles is not None:
        if ask is not None:
            ask(f"when {angles} is complete: Enter joins it")
        joined(segments, angles)
        _keep(path, segments)
    return read_sweep(path)


def _keep(path: Path, segments: Sequence[Segment]) -> None:
    if any(segment.time for segment in segments):
        write_sweep(path, added(path, segments))
        print(f"recorded: {path}", file=sys.stderr, flush=True)
