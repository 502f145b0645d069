"""The driving part of ``hpac sweep --port``: a hand is swept at its own pace, one servo at a time in
both directions, and watched: by a camera that sees the tags of ``hpac tags``, or by another program.

Whatever happens, the hand is opened and disarmed, and what was recorded is kept."""

import csv
import sys
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpac_gym.bridge import HandLink
from hpac_gym.bridge.commands import connector
from hpac_gym.calibration.driver import PROTOCOL, Segment, sweep_servo
from hpac_gym.calibration.record import (
    CLEARED,
    JOINT_COLUMNS,
    RecordError,
    Sweep,
    concatenate,
    joints_of_servo,
    read_sweep,
    write_sweep,
)
from hpac_gym.camera import CameraError
from hpac_gym.camera.detection import Device, Seen, Watch, lens_of
from hpac_gym.camera.sheet import STRIPS
from hpac_gym.model import HPAC, JOINTS, SERVO_INDEX, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.output import keep, writable_file, writing

APART = 0.1
"""Longest time between an angle of another program and the sample that takes it [s]."""
OLDEST = 1.0
"""Age of the last picture, or row of angles, at which a sweep is given up [s]."""
TAIL = 1 << 14
"""Bytes at the end of a file of angles in which its last row is looked for."""
PATIENCE = 5.0
"""Time for which a strip is looked for before the hand moves [s]."""
SIDES = {
    "thumb_mp": "along the axis of the thumb's MP joint, the thumb being in front of the palm",
    "index_mcp": "from the thumb's side",
    "middle_mcp": "from the thumb's side",
    "ring_mcp": "from the little finger's side",
    "pinky_mcp": "from the little finger's side",
    "thumb_cmc": "along the axis of the thumb's CMC joint",
}
"""From where the camera looks."""
TAUT = (
    "{}: it flexes from command 0 on. If its tendon is taut there, all its angles are off by a constant, "
    "which no camera sees: set the horn back by a tooth, and sweep again"
)
LEAST_SLACK = np.radians(0.3)
"""Slack, as an angle of the servo, below which a tendon may have been taut at rest (chosen): it is
known to 0.1° with 31 points, to 0.3° with 13 [rad].
"""


class Eye:
    """A camera before the strips, whose tags tell the angles.

    Args:
        camera: its number, or a video, and with a comma its file.
        ask: tells a person what to do, and waits; None: nobody is asked.

    Raises:
        CameraError: It cannot be opened, or its file is none.
    """

    def __init__(self, camera: str, ask: Callable[[str], object] | None = None) -> None:
        name, self._lens = lens_of(camera)
        self._watch = Watch(Device(name, self._lens.size), self._lens.tags)
        self._ask = ask
        self._last: Seen = {}

    def begin(self, servo: str) -> None:
        """Wait until all tags of a strip are seen.

        Raises:
            CameraError: Some are not, after `PATIENCE`.
        """
        if self._ask is not None:
            ids = ", ".join(f"{tag.id} {tag.label}" for tag in STRIPS[servo])
            self._ask(f"{servo}: tags {ids}; the camera looks {SIDES[servo]}. Enter sweeps it")
        deadline = time.monotonic() + PATIENCE
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

    def look(self) -> Seen:
        """The tags in the newest picture; none of them, if there is no other picture since the last
        call.

        Raises:
            CameraError: The last picture is older than `OLDEST`.
        """
        latest = self._watch.latest()
        if latest is None or latest[1] > OLDEST:
            raise CameraError(f"no picture for {OLDEST:g} s: {self._watch.fault or 'it hangs'}")
        if latest[0] is self._last:
            return {}
        self._last = latest[0]
        return self._last

    def measure(self, segment: Segment, hand: Hand) -> list[str]:
        """Find a segment's angles, and return what is to be told of them.

        Raises:
            CameraError: The tags do not show them.
        """
        try:
            misfit = segment.angles_from_tags(self._lens)
        except CameraError as error:
            raise CameraError(f"sweep of {segment.servo}: {error}") from None
        told = [f"its tags fit to {misfit:.2f} pixels"]
        if segment.servo == CLEARED and segment.slack(hand) < LEAST_SLACK:
            told.append(TAUT.format(segment.servo))
        return told

    def close(self) -> None:
        """Let the camera go."""
        self._watch.close()


class AnglesFile:
    """Another program, which writes the joints' angles into a file; see `angles_in`."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def begin(self, servo: str) -> None:
        """See that the program writes; raises as `look`."""
        self.look()

    def look(self) -> Seen:
        """See that the program writes angles now: no tags.

        Raises:
            RecordError: The last row of its file is older than `OLDEST`; or as of `angles_in`.
        """
        age = time.time() - angles_in(self._path, TAIL)[1][-1]
        if abs(age) > OLDEST:
            raise RecordError(
                f"angles {self._path}: its last row is {age:.4g} s old, the limit is {OLDEST:g} s: "
                "does a program write it, and time_s as seconds since 1970?"
            )
        return {}

    def measure(self, segment: Segment, hand: Hand) -> list[str]:
        """Find a segment's angles by the time of the day; there is nothing to be told of them.

        Raises:
            RecordError: As of `angles_in`; or the file has none of the swept joints.
        """
        names, at, angles = angles_in(self._path)
        wanted = np.array(segment.unix)
        joint_pos = np.full((len(wanted), len(JOINTS)), np.nan)
        for column, name in enumerate(names):
            known = ~np.isnan(angles[:, column])
            if not known.any():
                continue
            times = at[known]
            place = np.interp(wanted, times, np.arange(len(times)))
            near = np.abs(times[np.rint(place).astype(int)] - wanted) <= APART
            angle = np.interp(wanted, times, angles[known, column])
            joint_pos[:, JOINT_COLUMNS.index(name)] = np.where(near, angle, np.nan)
        if np.isnan(joint_pos[:, joints_of_servo(SERVO_INDEX[segment.servo])]).all():
            raise RecordError(
                f"angles {self._path}: none of the joints of {segment.servo} within {APART:g} s of a sample"
            )
        segment.joint_pos = joint_pos
        return []


def angles_in(path: Path, last: int = sys.maxsize) -> tuple[list[str], Array, Array]:
    """The columns of joints, the times since 1970, shape (n,) [s], and the angles, shape (n, columns)
    [rad], that another program writes, and its last line perhaps still.

    Args:
        path: a CSV file with the columns ``time_s`` and any of ``joint_{name}_rad``.
        last: take only the rows within so many bytes at its end.

    Raises:
        RecordError: The file cannot be read, or has no such columns or rows, or a time goes back.
    """
    try:
        with path.open("rb") as file:
            head = file.readline()
            file.seek(max(len(head), 1, file.seek(0, 2) - last) - 1)
            file.readline()
            lines = (head + file.read()).decode("utf-8-sig").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise RecordError(f"angles {path}: {reason}") from None
    try:
        rows = list(csv.DictReader(line for line in lines if line.endswith("\n")))
        names = [name for name in JOINT_COLUMNS if rows and name in rows[0]]
        if not names or "time_s" not in rows[0]:
            raise ValueError(f"no rows with time_s and any of {', '.join(JOINT_COLUMNS[:2])} …")
        at = np.array([float(row["time_s"]) for row in rows])
        angles = np.array([[float(row[name] or "nan") for name in names] for row in rows])
        if (
            not (np.isfinite(at).all() and (np.diff(at) > 0).all())
            or np.nanmax(np.abs(angles), initial=0.0) > np.pi
        ):
            raise ValueError("times must increase, and angles lie within ±π rad")
    except (csv.Error, TypeError, ValueError) as error:
        raise RecordError(f"angles {path}: {error}") from None
    return names, at, angles


def added(record: Sweep | None, segment: Segment) -> Sweep:
    """A record with a segment, which stands where the record has its like, otherwise first."""
    if record is None:
        return segment.sweep()
    like = (record.trial == segment.trial) & (record.swept == SERVO_INDEX[segment.servo])
    place = int(like.argmax())
    return concatenate([record[:place], segment.sweep(), record[place:][~like[place:]]])


def record(
    port: str,
    path: Path,
    *,
    camera: str = "0",
    angles: Path | None = None,
    servos: Iterable[str] = SERVOS,
    trial: int = 0,
    points: int | None = None,
    hand: Hand = HPAC,
    ask: Callable[[str], object] | None = None,
) -> Sweep:
    """Sweep a hand, and write the record: each servo as soon as it is complete.

    Args:
        port: as of every command.
        path: the record; what it has stays, but for servos of this trial that are swept to the end:
            then the file is kept as `NAME-1`, or the next free number.
        camera: measures the angles, as of `Eye`.
        angles: file that another program writes meanwhile, instead of a camera.
        servos: servos to sweep.
        trial: number of the repetition.
        points: sampling points of a servo; None: as many as `PROTOCOL` has.
        hand: the hand.
        ask: as of `Eye`.

    Raises:
        CameraError, BridgeError, RecordError, OutputError: See there.
    """
    writable_file(path)
    before = read_sweep(path) if path.exists() else None
    again = set() if before is None else set(before.swept[before.trial == trial].tolist())
    protocol = replace(PROTOCOL, points=points or PROTOCOL.points)
    with ExitStack() as stack:
        source: Eye | AnglesFile = (
            stack.enter_context(closing(Eye(camera, ask))) if angles is None else AnglesFile(angles)
        )
        link = stack.enter_context(HandLink(connector(port, stack, hand), hand=hand))
        for servo in dict.fromkeys(servos):
            source.begin(servo)
            words = f"sweep of {servo}, recorded when complete; Ctrl-C opens the hand"
            print(words, file=sys.stderr, flush=True)
            segment = Segment(servo, trial)
            sweep_servo(link, source.look, segment, hand, protocol)
            told = source.measure(segment, hand)
            # Read again: another program may have added to it meanwhile.
            whole = added(read_sweep(path) if path.exists() else None, segment)
            if SERVO_INDEX[servo] in again:
                again.clear()  # the others of this run are added to the same file
                with writing(path):
                    keep(path)
            write_sweep(path, whole)
            for line in (f"recorded: {servo} in {path}", *told):
                print(line, file=sys.stderr, flush=True)
    return read_sweep(path)
