"""The samples of a driven sweep, as they come, and the angles that a camera or another program gives
them."""

import csv
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from hpac_gym.calibration.judging import point_medians
from hpac_gym.calibration.record import (
    FLEXING,
    JOINT_COLUMNS,
    REST,
    RecordError,
    Sweep,
    concatenate,
    joints_of_servo,
)
from hpac_gym.camera.angles import turns
from hpac_gym.camera.detection import Lens, Seen
from hpac_gym.camera.sheet import CHAINS, STRIPS
from hpac_gym.model import JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, Hand, elastic_joints_from_servo
from hpac_gym.model.checks import Array

APART = 0.1
"""Longest time between an angle of another program and the sample that takes it [s]."""
FLEXED = 0.05
"""Least angle of a joint that has surely begun to flex (chosen) [rad]."""


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

    def angles_from_file(self, path: Path) -> None:
        """Find the joint angles in the file of another program, by the time of the day.

        Raises:
            RecordError: As of `angles_in`; or it has none of the swept joints.
        """
        names, at, angles = angles_in(path)
        wanted = np.array(self.unix)
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
        if np.isnan(joint_pos[:, joints_of_servo(SERVO_INDEX[self.servo])]).all():
            raise RecordError(
                f"angles {path}: none of the joints of {self.servo} within {APART:g} s of a sample"
            )
        self.joint_pos = joint_pos

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
