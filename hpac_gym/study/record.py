"""The record of a servo sweep, and its file `sweep.csv`: the same for a simulated hand and for a real one.

`docs/study.md` describes the format for whoever writes one.
"""

from __future__ import annotations

import csv
import io
import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hpac_gym.errors import HpacError
from hpac_gym.model import JOINTS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.output import write_text

HEADER = "# hpac sweep, format 1"
PHASES = ("rest", "flexion", "extension")
LABELS = ("trial", "swept", "phase", "point")
SERVO_COLUMNS = tuple(f"servo_{name}_rad" for name in SERVOS)
JOINT_COLUMNS = tuple(f"joint_{name}_rad" for name in JOINTS)
COLUMNS = (*LABELS, "time_s", *SERVO_COLUMNS, *JOINT_COLUMNS)

ANGLE_LIMIT = np.pi
"""No servo or joint of the hand turns further [rad]: a larger number is in degrees."""


class RecordError(HpacError, ValueError):
    """A sweep record lacks a column, or holds a value that cannot be what it says; the message names column and row."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """A record, one entry a camera sample.

    A *segment* is what belongs together in time: one trial of one swept servo, rest, flexion, and maybe extension.
    """

    trial: np.ndarray
    """Number of the repetition, shape (n,)."""
    swept: np.ndarray
    """Index in `SERVOS` of the servo that the segment sweeps, shape (n,)."""
    phase: np.ndarray
    """Index in `PHASES`, shape (n,)."""
    point: np.ndarray
    """Number of the sampling point while the servos hold still there, −1 in motion, shape (n,)."""
    time: Array
    """Shape (n,) [s]."""
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
        return [np.arange(a, b) for a, b in zip(starts, [*starts[1:], len(self)], strict=True)]

    def with_joint_pos(self, joint_pos: Array) -> Sweep:
        """The same record with other joint angles."""
        return replace(self, joint_pos=joint_pos)


def concatenate(parts: list[Sweep]) -> Sweep:
    """Several records as one, in order."""
    return Sweep(*(np.concatenate([getattr(part, name) for part in parts]) for name in Sweep.__slots__))


def joints_of_servo(servo: int) -> list[int]:
    """Indices in `JOINTS` of what a servo moves."""
    name = SERVOS[servo]
    if name == "thumb_cmc":
        return [JOINTS.index(name)]
    digit = name.split("_")[0]
    return [index for index, joint in enumerate(JOINTS) if joint.startswith(digit) and joint != "thumb_cmc"]


# Writing -----------------------------------------------------------------------


def write_sweep(path: str | os.PathLike[str], sweep: Sweep) -> None:
    """Write `sweep.csv`, whole or not at all; angles to 1e-7 rad.

    Raises:
        OutputError: The file cannot be written.
    """
    text = io.StringIO()
    text.write(HEADER + "\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in range(len(sweep)):
        labels = (int(sweep.trial[row]), SERVOS[sweep.swept[row]], PHASES[sweep.phase[row]], int(sweep.point[row]))
        angles = np.concatenate([sweep.servo[row], sweep.joint_pos[row]])
        writer.writerow([*labels, f"{sweep.time[row]:.4f}", *("" if np.isnan(x) else f"{x:.7f}" for x in angles)])
    write_text(path, text.getvalue())


# Reading -----------------------------------------------------------------------


def read_sweep(path: str | os.PathLike[str], allow_missing: bool = False) -> Sweep:
    """The record in a `sweep.csv`.

    Args:
        path: the file.
        allow_missing: take a joint column that is absent for "not measured". An empty cell in a joint column always is.

    Raises:
        RecordError: The file cannot be read, lacks a column, or has a cell that is NaN, not a number, in degrees or
            unknown; or time does not rise within a segment.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except OSError as error:
        raise RecordError(f"sweep {path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise RecordError(f"sweep {path}: not UTF-8 text") from None
    try:
        return _parse(lines, allow_missing)
    except RecordError as error:
        raise RecordError(f"sweep {path}: {error}") from None


def _parse(lines: list[str], allow_missing: bool) -> Sweep:
    if not lines or lines[0].strip() != HEADER:
        raise RecordError(f"row 1 must be {HEADER!r}, not {lines[0][:60] if lines else ''!r}")
    numbers = [number for number, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    cells = list(csv.reader(lines[number - 1] for number in numbers))
    if len(cells) < 2:
        raise RecordError("no rows of data")
    columns, rows, numbers = [name.strip() for name in cells[0]], cells[1:], numbers[1:]
    for name in COLUMNS:
        absent = allow_missing and name in JOINT_COLUMNS and name not in columns and f"{name[:-3]}deg" not in columns
        if columns.count(name) != 1 and not absent:
            found = [column for column in columns if column.removesuffix("_deg") == name.removesuffix("_rad")]
            fault = "there twice" if name in columns else f"missing; {found[0]} is in degrees" if found else "missing"
            raise RecordError(f"column {name} is {fault}")
    for number, row in zip(numbers, rows, strict=True):
        if len(row) != len(columns):
            raise RecordError(f"row {number} has {len(row)} cells, the header {len(columns)}")
    table = _Table({name: [row[i].strip() for row in rows] for i, name in enumerate(columns)}, numbers)
    sweep = Sweep(
        trial=table.integers("trial"),
        swept=table.words("swept", SERVOS),
        phase=table.words("phase", PHASES),
        point=table.integers("point"),
        time=table.numbers("time_s"),
        servo=np.stack([table.angles(name) for name in SERVO_COLUMNS], axis=1),
        joint_pos=np.stack([table.angles(name) for name in JOINT_COLUMNS], axis=1),
    )
    _check_time(sweep, numbers)
    return sweep


@dataclass(frozen=True, slots=True)
class _Table:
    """The cells of a file by column, and the file's row numbers, which errors name."""

    cells: dict[str, list[str]]
    rows: list[int]

    def numbers(self, column: str) -> Array:
        values = np.full(len(self.rows), np.nan)
        for index, cell in enumerate(self.cells.get(column, [""] * len(self.rows))):
            if not cell and column in JOINT_COLUMNS:
                continue
            try:
                values[index] = float(cell)
            except ValueError:
                raise RecordError(f"column {column}, row {self.rows[index]}: {cell!r} is not a number") from None
            if not np.isfinite(values[index]):
                raise RecordError(f"column {column}, row {self.rows[index]}: {cell} is not a finite number")
        return values

    def angles(self, column: str) -> Array:
        values = self.numbers(column)
        large = np.flatnonzero(np.abs(values) > ANGLE_LIMIT)
        if large.size:
            raise RecordError(
                f"column {column}, row {self.rows[large[0]]}: {values[large[0]]:g} rad is beyond {ANGLE_LIMIT:.4g} rad; "
                f"is it in degrees?"
            )
        return values

    def integers(self, column: str) -> np.ndarray:
        values = self.numbers(column)
        broken = np.flatnonzero(values != np.round(values))
        if broken.size:
            raise RecordError(f"column {column}, row {self.rows[broken[0]]}: {values[broken[0]]:g} is not a whole number")
        return values.astype(int)

    def words(self, column: str, known: tuple[str, ...]) -> np.ndarray:
        for index, cell in enumerate(self.cells[column]):
            if cell not in known:
                raise RecordError(f"column {column}, row {self.rows[index]}: {cell!r} is none of {', '.join(known)}")
        return np.array([known.index(cell) for cell in self.cells[column]])


def _check_time(sweep: Sweep, numbers: list[int]) -> None:
    for rows in sweep.segments():
        late = np.flatnonzero(np.diff(sweep.time[rows]) <= 0)
        if late.size:
            row = rows[late[0] + 1]
            before, now = sweep.time[row - 1], sweep.time[row]
            raise RecordError(f"column time_s, row {numbers[row]}: {now:g} s does not follow {before:g} s")
