"""`sweep.csv`: what is written is read again, and every fault of a file is told with its column and
row.
"""

import numpy as np
import pytest

from hpac_gym.calibration.record import (
    COLUMNS,
    HEADER,
    RecordError,
    Sweep,
    concatenate,
    read_sweep,
    write_sweep,
)
from hpac_gym.model import JOINTS
from hpac_gym.model.settled import settled_joints_from_servo


def made_up_sweep(swept: int = 1, trial: int = 0) -> Sweep:
    """Five rows of rest, then 25 of a flexion, without noise."""
    rows = 30
    servo = np.zeros((rows, 6))
    servo[5:, swept] = np.linspace(0.02, 1.0, rows - 5)
    phase = (np.arange(rows) >= 5).astype(int)
    point = np.where(phase == 1, np.arange(rows) - 5, -1)
    time = 0.05 * np.arange(1, rows + 1)
    return Sweep(
        np.full(rows, trial),
        np.full(rows, swept),
        phase,
        point,
        time,
        servo,
        settled_joints_from_servo(servo),
    )


@pytest.fixture
def lines(tmp_path) -> list[str]:
    """The lines of a good file; line 1 is the header, line 2 the column names."""
    write_sweep(tmp_path / "good.csv", made_up_sweep())
    return (tmp_path / "good.csv").read_text().splitlines()


def with_cell(lines: list[str], row: int, column: str, text: str) -> list[str]:
    cells = lines[row - 1].split(",")
    cells[COLUMNS.index(column)] = text
    return [*lines[: row - 1], ",".join(cells), *lines[row:]]


def without_column(lines: list[str], column: str) -> list[str]:
    index = COLUMNS.index(column)
    cut = [
        ",".join(cell for i, cell in enumerate(line.split(",")) if i != index) for line in lines[1:]
    ]
    return [lines[0], *cut]


def read(tmp_path, lines: list[str]) -> Sweep:
    path = tmp_path / "sweep.csv"
    path.write_text("\n".join(lines) + "\n")
    return read_sweep(path)


def test_a_written_sweep_is_read_again(tmp_path):
    sweep = concatenate([made_up_sweep(1), made_up_sweep(0, trial=2)])
    write_sweep(tmp_path / "sweep.csv", sweep)
    again = read_sweep(tmp_path / "sweep.csv")
    for name in ("trial", "swept", "phase", "point"):
        assert (getattr(again, name) == getattr(sweep, name)).all()
    for name in ("time", "servo", "joint_pos"):
        assert getattr(again, name) == pytest.approx(getattr(sweep, name), abs=6e-8)


def test_columns_may_come_in_any_order_beside_others_and_comments(tmp_path, lines):
    reordered = [lines[0], "# a hand on a bench"]
    reordered += [",".join([*reversed(line.split(",")), "x"]) for line in lines[1:]]
    assert (read(tmp_path, reordered).servo == read(tmp_path, lines).servo).all()


def test_cells_may_be_quoted_after_a_byte_order_mark(tmp_path, lines):
    quoted = [",".join(f'"{cell}"' for cell in line.split(",")) for line in lines[1:]]
    marked = read(tmp_path, ["\ufeff" + lines[0], *quoted])
    assert (marked.servo == read(tmp_path, lines).servo).all()


def test_segments_are_what_belongs_together_in_time():
    sweep = concatenate([made_up_sweep(1), made_up_sweep(1, trial=1), made_up_sweep(4, trial=1)])
    assert [len(rows) for rows in sweep.segments()] == [30, 30, 30]
    assert [int(sweep.swept[rows[0]]) for rows in sweep.segments()] == [1, 1, 4]
    assert sweep[:0].segments() == []


CELL_FAULTS = [
    (
        "joint_index_dip_rad",
        12,
        "nan",
        r"column joint_index_dip_rad, row 12: nan is not a finite number",
    ),
    (
        "joint_index_dip_rad",
        12,
        "inf",
        r"column joint_index_dip_rad, row 12: inf is not a finite number",
    ),
    ("servo_index_mcp_rad", 12, "", r"column servo_index_mcp_rad, row 12: '' is not a number"),
    ("servo_thumb_mp_rad", 3, "half", r"column servo_thumb_mp_rad, row 3: 'half' is not a number"),
    (
        "joint_ring_pip_rad",
        20,
        "57.3",
        r"column joint_ring_pip_rad, row 20: 57\.3 rad is beyond 3\.142 rad; is it in degrees\?",
    ),
    (
        "servo_index_mcp_rad",
        31,
        "79.4",
        r"column servo_index_mcp_rad, row 31: 79\.4 rad is beyond .* degrees",
    ),
    ("swept", 9, "index", r"column swept, row 9: 'index' is not one of thumb_mp, index_mcp"),
    (
        "phase",
        9,
        "closing",
        r"column phase, row 9: 'closing' is not one of rest, flexion, extension",
    ),
    ("trial", 9, '"0', r"row 9 has 1 cells, the header 26"),
    ("trial", 9, "9" * 200_000, "field larger than field limit"),
    ("point", 9, "1.5", r"column point, row 9: 1\.5 is not a whole number"),
    ("trial", 9, "1e30", r"column trial, row 9: 1e\+30 is not a whole number within ±1e\+09"),
    ("time_s", 9, "0.1", r"column time_s, row 9: 0\.1 s does not follow 0\.3 s"),
]


@pytest.mark.parametrize(("column", "row", "text", "message"), CELL_FAULTS)
def test_a_faulty_cell_is_told_with_column_and_row(tmp_path, lines, column, row, text, message):
    with pytest.raises(RecordError, match=message) as caught:
        read(tmp_path, with_cell(lines, row, column, text))
    assert str(caught.value).startswith(f"sweep {tmp_path / 'sweep.csv'}: ")


@pytest.mark.parametrize("column", COLUMNS[: -len(JOINTS)])
def test_a_missing_column_is_named(tmp_path, lines, column):
    with pytest.raises(RecordError, match=rf"column {column} is missing"):
        read(tmp_path, without_column(lines, column))


def test_a_column_twice_is_told(tmp_path, lines):
    twice = [lines[0], *(f"{line},{line.split(',')[-1]}" for line in lines[1:])]
    with pytest.raises(RecordError, match="column joint_thumb_cmc_rad is there twice"):
        read(tmp_path, twice)


@pytest.mark.parametrize(
    ("cut", "message"),
    [
        (lambda lines: [], r"row 1 must be .* not ''"),
        (lambda lines: lines[1:], r"row 1 must be '# hpac sweep, format 1', not 'trial"),
        (lambda lines: [HEADER.replace("1", "2"), *lines[1:]], "row 1 must be"),
        (lambda lines: lines[:1], "no rows of data"),
        (lambda lines: lines[:2], "no rows of data"),
        (
            lambda lines: [*lines[:6], lines[6] + ",1.0", *lines[7:]],
            r"row 7 has 27 cells, the header 26",
        ),
    ],
)
def test_a_file_that_is_no_sweep_is_told(tmp_path, lines, cut, message):
    with pytest.raises(RecordError, match=message):
        read(tmp_path, cut(lines))


def test_a_file_that_cannot_be_read_is_told(tmp_path):
    with pytest.raises(RecordError, match=r"none\.csv: No such file"):
        read_sweep(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RecordError, match="not UTF-8"):
        read_sweep(tmp_path / "binary.csv")


def test_an_empty_cell_of_a_joint_is_not_measured(tmp_path, lines):
    sweep = read(tmp_path, with_cell(lines, 12, "joint_index_dip_rad", ""))
    assert np.flatnonzero(np.isnan(sweep.joint_pos[:, JOINTS.index("index_dip")])).tolist() == [
        12 - 3
    ]


def test_a_joint_column_may_be_absent_but_not_in_degrees(tmp_path, lines):
    sweep = read(tmp_path, without_column(lines, "joint_thumb_cmc_rad"))
    assert np.isnan(sweep.joint_pos[:, JOINTS.index("thumb_cmc")]).all()
    degrees = [lines[0], lines[1].replace("joint_index_dip_rad", "joint_index_dip_deg"), *lines[2:]]
    with pytest.raises(
        RecordError,
        match="column joint_index_dip_rad is missing; joint_index_dip_deg is in degrees",
    ):
        read(tmp_path, degrees)
