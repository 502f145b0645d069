"""The protocol of a servo sweep, its record, and the record's file `sweep.csv` (`docs/calibrate.md`):
the same for a simulated hand and for a real one.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from hpac_gym.errors import HpacError
from hpac_gym.model import HPAC, JOINTS, SERVO_INDEX, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.output import read_text, write_text

HEADER = "# hpac sweep, format 1"
PHASES = ("rest", "flexion", "extension")
REST, FLEXING, EXTENDING = range(len(PHASES))
LABELS = ("trial", "swept", "phase", "point")
SERVO_COLUMNS = tuple(f"servo_{name}_rad" for name in SERVOS)
JOINT_COLUMNS = tuple(f"joint_{name}_rad" for name in JOINTS)
COLUMNS = (*LABELS, "time_s", *SERVO_COLUMNS, *JOINT_COLUMNS)

ANGLE_LIMIT = np.pi
"""No servo or joint of the hand turns further [rad]; a larger number is in degrees."""
MOST_LABEL = 1e9
"""Largest number of a trial or a point (chosen)."""
THUMB_CLEAR = 1.2
"""CMC angle at which the thumb can flex over its whole range without touching fingers or palm
[rad].
"""
CLEARED = "thumb_mp"
"""Servo during whose sweep the thumb's CMC holds `THUMB_CLEAR`, also at rest."""


class RecordError(HpacError, ValueError):
    """A sweep record lacks a column or contains an invalid value; the message names column and
    row.
    """


def rest_pose(swept: str, hand: Hand = HPAC) -> Array:
    """Initial servo angles of a sweep: open, with the thumb clear of the index if it is swept,
    shape (6,) [rad].
    """
    pose = np.zeros(len(SERVOS))
    if swept == CLEARED:
        pose[SERVO_INDEX["thumb_cmc"]] = THUMB_CLEAR
    return np.clip(pose, hand.servo_min, hand.servo_max)


@dataclass(frozen=True, slots=True)
class Protocol:
    """Protocol of a servo sweep: rest, K points in sequence, back to rest."""

    points: int = 31
    """Number of points K over the servo's admissible range, including both ends."""
    seconds_per_point: float = 1.5
    hold: float = 0.5
    """Final part of a point, in which the servo is stationary and samples count [s]."""
    rest: float = 2.0
    """Duration of the rest before and after, with a slack tendon and the digit against its stops
    [s].
    """
    both_directions: bool = False
    """Whether points are also taken in extension, at the same angles."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """A record with one entry per camera sample.

    A *segment* is contiguous in time: one trial of one swept servo, with rest, flexion, and
    possibly extension."""

    trial: np.ndarray
    """Number of the repetition, shape (n,)."""
    swept: np.ndarray
    """Index in `SERVOS` of the servo that the segment sweeps, shape (n,)."""
    phase: np.ndarray
    """Index in `PHASES`, shape (n,)."""
    point: np.ndarray
    """Number of the sampling point while the servos are stationary there, −1 in motion, shape (n,).
    """
    time: Array
    """Time of the sample, shape (n,) [s]."""
    servo: Array
    """Commanded servo angles u, shape (n, 6) [rad]."""
    joint_pos: Array
    """Measured joint angles q, shape (n, 15) [rad]; NaN where there is no measurement."""

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: np.ndarray | slice) -> Sweep:
        return Sweep(*(getattr(self, name)[rows] for name in self.__slots__))

    def segments(self) -> list[np.ndarray]:
        """Row numbers of each segment, in the order of the record."""
        keys = self.trial.astype(int) * len(SERVOS) + self.swept
        starts = np.flatnonzero(np.diff(keys, prepend=keys[:1] - 1))
        return [np.arange(a, b) for a, b in pairwise([*starts, len(self)])]

    def measured(self) -> list[str]:
        """Joints that are measured at a sampling point of their own servo's sweep."""
        seen = ~np.isnan(self.joint_pos) & (HPAC.servo_of_joint == self.swept[:, None])
        held = (self.phase != REST) & (self.point >= 0)
        return [JOINTS[joint] for joint in np.flatnonzero(seen[held].any(axis=0))]

    def with_joint_pos(self, joint_pos: Array) -> Sweep:
        """The same record with other joint angles."""
        return replace(self, joint_pos=joint_pos)


def concatenate(parts: list[Sweep]) -> Sweep:
    """Several records as one, in order."""
    return Sweep(
        *(np.concatenate([getattr(part, name) for part in parts]) for name in Sweep.__slots__)
    )


def joints_of_servo(servo: int) -> list[int]:
    """Indices in `JOINTS` of the joints that a servo moves."""
    return np.flatnonzero(HPAC.servo_of_joint == servo).tolist()


# Writing -----------------------------------------------------------------------


def write_sweep(path: str | os.PathLike[str], sweep: Sweep) -> None:
    """Write `sweep.csv` atomically; angles to 1e-7 rad.

    Raises:
        OutputError: The file cannot be written.
    """
    lines = [HEADER, ",".join(COLUMNS)]
    for row in range(len(sweep)):
        labels = (
            f"{sweep.trial[row]:.0f}",
            SERVOS[sweep.swept[row]],
            PHASES[sweep.phase[row]],
            f"{sweep.point[row]:.0f}",
        )
        angles = np.concatenate([sweep.servo[row], sweep.joint_pos[row]])
        cells = ("" if np.isnan(angle) else f"{angle:.7f}" for angle in angles)
        lines.append(",".join([*labels, f"{sweep.time[row]:.4f}", *cells]))
    write_text(path, "\n".join(lines) + "\n")


# Reading -----------------------------------------------------------------------


def read_sweep(path: str | os.PathLike[str]) -> Sweep:
    """Read the record in a `sweep.csv`; a joint without a column or with an empty cell is not
    measured.

    Raises:
        RecordError: The file cannot be read, lacks a column, or has a cell that is NaN, not a
            number, in degrees or unknown; or time does not increase within a segment.
    """
    path = Path(path)
    lines = read_text(path, "sweep", RecordError, "utf-8-sig").splitlines()
    try:
        return _parse(lines)
    except (RecordError, csv.Error) as error:
        raise RecordError(f"sweep {path}: {error}") from None


def _parse(lines: list[str]) -> Sweep:
    if not lines or lines[0].strip() != HEADER:
        raise RecordError(f"row 1 must be {HEADER!r}, not {lines[0][:60] if lines else ''!r}")
    # Each line by itself: a quotation mark that nothing closes is a fault of its row alone.
    table = [
        (number, next(csv.reader([line])))
        for number, line in enumerate(lines, 1)
        if line.strip() and not line.startswith("#")
    ]
    if len(table) < 2:
        raise RecordError("no rows of data")
    (_, head), *rows = table
    names = [name.strip() for name in head]
    for number, cells in rows:
        if len(cells) != len(names):
            raise RecordError(f"row {number} has {len(cells)} cells, the header {len(names)}")
    trial, swept, phase, point, time, *angles = (_column(name, names, rows) for name in COLUMNS)
    servo = np.stack(angles[: len(SERVOS)], axis=1)
    joint_pos = np.stack(angles[len(SERVOS) :], axis=1)
    sweep = Sweep(trial, swept, phase, point, time, servo, joint_pos)
    for segment in sweep.segments():
        late = segment[1:][np.diff(sweep.time[segment]) <= 0]
        if late.size:
            raise RecordError(
                f"column time_s, row {rows[late[0]][0]}: {sweep.time[late[0]]:g} s does not follow "
                f"{sweep.time[late[0] - 1]:g} s"
            )
    return sweep


def _column(name: str, names: list[str], rows: list[tuple[int, list[str]]]) -> np.ndarray:
    """Parse a column, from the names of all and the cells of each row, with its number in the file."""
    in_degrees = name.replace("_rad", "_deg")
    if name in JOINT_COLUMNS and name not in names and in_degrees not in names:
        return np.full(len(rows), np.nan)
    if names.count(name) != 1:
        degrees = f"; {in_degrees} is in degrees" if in_degrees in names else ""
        raise RecordError(
            f"column {name} is {'there twice' if name in names else f'missing{degrees}'}"
        )
    place = names.index(name)
    values = []
    for row, cells in rows:
        try:
            values.append(_value(name, cells[place].strip()))
        except ValueError as error:
            raise RecordError(f"column {name}, row {row}: {error}") from None
    return np.array(values)


def _value(name: str, cell: str) -> float | int:
    """Parse a cell; the ValueError states what is wrong."""
    words = {"swept": SERVOS, "phase": PHASES}.get(name)
    if words:
        if cell not in words:
            raise ValueError(f"{cell!r} is not one of {', '.join(words)}")
        return words.index(cell)
    if not cell and name in JOINT_COLUMNS:
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        raise ValueError(f"{cell!r} is not a number") from None
    if not np.isfinite(value):
        raise ValueError(f"{cell} is not a finite number")
    if name in LABELS:
        if value != round(value) or abs(value) > MOST_LABEL:
            raise ValueError(f"{value:g} is not a whole number within ±{MOST_LABEL:g}")
        return round(value)
    if name != "time_s" and abs(value) > ANGLE_LIMIT:
        raise ValueError(f"{value:g} rad is beyond {ANGLE_LIMIT:.4g} rad; is it in degrees?")
    return value
