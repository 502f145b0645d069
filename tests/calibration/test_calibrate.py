"""`hpac calibrate`: what its first line is about, what it doubts, and what it refuses."""

import json
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

import hpac
from experiments.quasistatic import hand_course
from hpac_gym.calibration.calibrate import named
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import FLEXING, REST, write_sweep
from hpac_gym.calibration.report import (
    BOUND,
    WORST_OF_JOINTS,
    FileError,
    expected_worst_deg,
)
from hpac_gym.model import HPAC, JOINT_INDEX, SERVOS, load_hand
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.output import OutputError
from tests.calibration.conftest import of_servos


@pytest.fixture
def calibrate(tmp_path, capsys, monkeypatch):
    """The command, without what takes longest and says nothing here: the figure, most draws."""
    monkeypatch.setattr("hpac_gym.calibration.calibrate.save", lambda *_: None)
    monkeypatch.setattr("hpac_gym.calibration.calibrate.DRAWS", 2)

    def run(record, *words, second=None):
        path = tmp_path / "sweep.csv"
        write_sweep(path, record)
        if second is not None:
            write_sweep(tmp_path / "second.csv", second)
            words += "--check", str(tmp_path / "second.csv")
        status = hpac.main(["calibrate", str(path), "--out", str(tmp_path / "hand.toml"), *words])
        return status, capsys.readouterr()

    return run


def test_a_place_that_cannot_be_written_to_is_told_before_the_fit(
    nominal_record, calibrate, tmp_path, monkeypatch
):
    monkeypatch.delattr("hpac_gym.calibration.calibrate.identify")
    (tmp_path / "hand.toml").mkdir()
    status, said = calibrate(nominal_record)
    assert (status, said.out) == (2, "")
    assert f"error: cannot write '{tmp_path / 'hand.toml'}': it is a folder" in said.err


@pytest.mark.parametrize("read", ["record", "--check", "--base"])
def test_no_file_that_is_read_is_replaced(nominal_record, calibrate, tmp_path, read):
    path = tmp_path / ("sweep.csv" if read == "record" else "read")
    words = () if read == "record" else (read, str(path))
    (tmp_path / "link").symlink_to(tmp_path)
    out = tmp_path / "link" / path.name
    status, said = calibrate(nominal_record, *words, "--out", str(out))
    assert (status, said.err) == (2, f"error: --out {out} would replace a file that is read\n")


def test_a_full_disk_leaves_all_files_of_the_last_calibration(
    nominal_record, calibrate, tmp_path, monkeypatch
):
    """A new report beside an old hand file would be read as that file's."""
    assert calibrate(nominal_record)[0] == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    full = Mock(side_effect=OutputError("cannot write 'fit.png': No space left on device"))
    monkeypatch.setattr("hpac_gym.calibration.calibrate.save", full)
    other = nominal_record.with_joint_pos(1.01 * nominal_record.joint_pos)
    status, said = calibrate(other)
    assert (status, said.err) == (2, "error: cannot write 'fit.png': No space left on device\n")
    after = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    assert [path.name for path in before if after.pop(path) != before[path]] == ["sweep.csv"]
    assert not after


def test_a_sweep_is_no_check_on_itself(record, calibrate, tmp_path):
    status, said = calibrate(of_index(record), second=of_index(record))
    assert status == 2
    assert "second.csv is the same sweep; it must be a second one" in said.err
    assert not (tmp_path / "hand.toml").exists()


def test_a_check_measures_every_joint_that_the_sweep_does(record, calibrate, tmp_path, monkeypatch):
    """What the file does to the other joints would be in no bound."""
    monkeypatch.delattr("hpac_gym.calibration.calibrate.identify")
    first = of_servos(record, "thumb_mp", "index_mcp")
    status, said = calibrate(first, second=with_last_rest(of_index(record), 0.01))
    assert (status, said.out) == (2, "")
    assert "second.csv does not measure thumb_ip, thumb_mp: its bound is" in said.err


def test_a_second_sweep_is_what_the_first_line_is_about(record, second, calibrate, tmp_path):
    servos = "index_mcp", "thumb_cmc"
    status, said = calibrate(of_servos(record, *servos), second=of_servos(second, *servos))
    assert status == 0
    report = json.loads((tmp_path / "hand-report" / "report.json").read_text())
    worst = report["expected_worst_deg"]
    assert max(error["mean_abs_deg"] for error in report["file_error"].values()) / 2 < worst < 0.2
    assert report["bound_95_deg"] == pytest.approx(BOUND * worst)
    first = said.out.splitlines()[2]
    assert first.startswith("Judged on the independent sweep second.csv, commands with")
    assert f"by {worst:.2f}° at the worst joint" in first
    assert first.endswith(f"with 95 % confidence by at most {BOUND * worst:.2f}°.")


def test_the_expected_worst_joint_lies_between_the_largest_and_what_all_joints_let_expect():
    errors = {str(i): FileError(error, 1.0, 0.1, 9) for i, error in enumerate([0.1] * 3 + [0.8])}
    rms = np.sqrt((3 * 0.01 + 0.64) / 4)
    assert expected_worst_deg(errors) == pytest.approx(np.sqrt(0.8 * WORST_OF_JOINTS * rms))
    alike = {str(i): FileError(0.3, 1.0, 0.1, 9) for i in range(4)}
    assert expected_worst_deg(alike) == pytest.approx(0.3 * np.sqrt(WORST_OF_JOINTS))


def _worst(out):
    return float(out.partition("on average and ")[2].partition("°")[0].removeprefix("by "))


def test_a_stop_of_the_cmc_and_a_joint_that_is_not_measured_are_told(record, calibrate, tmp_path):
    column = JOINT_INDEX["thumb_cmc"]
    digits = of_servos(record, "index_mcp", "thumb_cmc")
    stopped = digits.joint_pos.copy()
    stopped[:, JOINT_INDEX["index_dip"]] = np.nan
    stopped[digits.swept == 5, column] = np.minimum(stopped[digits.swept == 5, column], 1.1)
    status, said = calibrate(digits.with_joint_pos(stopped))
    assert status == 0
    assert "thumb_cmc rests at 1.100 rad" in said.out
    assert "Not measured: index_dip" in said.out
    hand = load_hand(tmp_path / "hand.toml")
    assert hand.workspace["thumb_cmc"][1] == pytest.approx(1.1, abs=1e-3)
    assert hand.sources["workspace"].endswith("up to the stops in sweep.csv")


def of_index(record):
    return of_servos(record, "index_mcp")


def with_last_rest(record, degrees):
    """A digit that does not come back to its stops."""
    last = (record.phase == REST) & (record.time > record.time[record.phase == FLEXING].max())
    return record.with_joint_pos(record.joint_pos + np.deg2rad(degrees) * last[:, None])


def index_error(identified, hidden):
    """Mean error of the joint of the index that is worst [°]."""
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 17)
    off = settled_joints_from_servo(servo, identified.hand) - hand_course([hidden], servo)[0]
    joints = [JOINT_INDEX[name] for name in HPAC.digits["index"].joints]
    return np.degrees(np.abs(off[:, joints])).mean(axis=0).max()


def test_rests_that_differ_are_told_and_bend_no_curve(record, hidden, calibrate):
    """With a straight line through both rests the file would be off by more than 1°."""
    spoiled = with_last_rest(of_index(record), 2.0)
    status, said = calibrate(spoiled)
    assert status == 0
    assert "the rests of index_dip, index_pip, index_mcp differ by up to 1.9°" in said.out
    assert index_error(identify(spoiled), hidden) < 0.2


def test_a_drift_between_rests_that_differ_is_fitted_in_both_directions(hidden, both_ways):
    """The camera turned by 2° in the course of the sweep: the way back tells it from the geometry."""
    turned = drifting(both_ways, np.deg2rad(2.0) / np.ptp(both_ways.time))
    identified = identify(turned)
    sources = named(identified, HPAC, "one.csv").sources
    kept = "identified from one.csv, about H-PAC; thumb, middle, ring, pinky as there"
    assert sources["d2"] == kept
    assert sources["cmc_gain"] == HPAC.sources["cmc_gain"]
    assert index_error(identified, hidden) < 0.15


def drifting(record, rate):
    """A camera that turns [rad/s]."""
    drift = rate * (record.time - record.time[0])
    return record.with_joint_pos(record.joint_pos + drift[:, None])


def test_rests_that_differ_by_a_cameras_drift_are_not_told(nominal_record, both_ways):
    """Two and a half standard deviations of the usual drift, in a short record and in a long one."""
    for record in (nominal_record, both_ways):
        remarks = judged(drifting(record, np.deg2rad(0.5) / 60), HPAC)
        assert not [remark for remark in remarks if "rests" in remark]


def test_a_camera_that_is_not_square_shows_in_the_second_sweep(record, second, calibrate):
    """Alone, the fit takes most of it for geometry, and tells the rest as scatter."""
    index = of_index(record)
    askew = index.with_joint_pos(index.joint_pos + np.deg2rad(2.5) * np.sin(2 * index.joint_pos))
    alone = calibrate(askew)[1].out
    assert "the points scatter" in alone
    _, said = calibrate(askew, second=of_index(second))
    assert _worst(said.out) > 2.5 * _worst(alone)
    assert "the two sweeps differ by more than 1.5° in" in said.out


def test_a_check_that_measures_more_contradicts_nothing(record, second, calibrate):
    """What the first sweep does not have keeps the design's numbers, which no sweep contradicts."""
    status, said = calibrate(of_index(record), second=of_servos(second, "index_mcp", "middle_mcp"))
    assert status == 0
    assert "Judged on" in said.out
    assert "middle_pip" not in said.out.partition("Remark")[2]
    assert "the two sweeps differ" not in said.out


def as_a_share(record):
    digits = of_servos(record, "index_mcp", "thumb_cmc")
    return replace(digits, servo=digits.servo / HPAC.servo_max)


def one_point_ahead(record):
    """Every servo then seems to have a zero of one step; a hand's own zeros differ."""
    digits = of_servos(record, "index_mcp", "middle_mcp", "ring_mcp")
    held = (digits.phase == FLEXING) & (digits.point >= 0)
    servo = digits.servo.copy()
    for column, top in enumerate(HPAC.servo_max):
        rows = held & (digits.swept == column)
        step = (top - HPAC.servo_min[column]) / digits.point.max()
        servo[rows, column] = np.minimum(servo[rows, column] + step, top)
    return replace(digits, servo=servo)


def later(record):
    """A column of another time, in a record with the frames between the points."""
    index = of_index(record)
    return replace(index, servo=np.vstack([index.servo[4:], index.servo[-4:]]))


def markers_exchanged(record):
    """For three seconds."""
    index = of_index(record)
    swapped = index.joint_pos.copy()
    pair = [JOINT_INDEX["index_pip"], JOINT_INDEX["index_dip"]]
    rows = (index.time > 30) & (index.time < 33)
    swapped[np.ix_(rows, pair)] = swapped[np.ix_(rows, pair[::-1])]
    return index.with_joint_pos(swapped)


def slipping(record):
    """Half way."""
    index = of_index(record)
    late = index.servo[:, 1] > 0.5 * HPAC.servo_max[1]
    return index.with_joint_pos(index.joint_pos - np.deg2rad(1.7) * late[:, None])


def wobbling(record, name, degrees):
    """From point to point, for all joints; the middle finger is well."""
    digits = of_servos(record, name, "middle_mcp")
    moving = (digits.point >= 0) & (digits.swept == SERVOS.index(name))
    wobble = np.deg2rad(degrees) * np.sin(2.4 * digits.point) * moving
    return digits.with_joint_pos(digits.joint_pos + wobble[:, None])


def root_scaled(record):
    """All other joints of the digit then turn too little for it."""
    index = of_index(record)
    scale = np.where(np.arange(index.joint_pos.shape[1]) == JOINT_INDEX["index_mcp"], 1.1, 1.0)
    return index.with_joint_pos(scale * index.joint_pos)


SPOILED = [
    (
        as_a_share,
        0,
        "standard deviations from the design; are the servo's angles in radians",
        "off the design's 1.000, and no tendon is between",
    ),
    (
        one_point_ahead,
        0,
        "the zeros of all 3 servos are about -0.9 steps of the sweep",
        "one point ahead of the angles?",
    ),
    (
        markers_exchanged,
        0,
        "points of index_pip lie up to 6° beside the course of the others",
        "were markers exchanged for a while?",
    ),
    (
        root_scaled,
        0,
        "index: all joints turn -",
        "is the scale of the root joint's angle off, or its radius?",
    ),
    (slipping, 0, "index: the points scatter"),
    (later, 2, "servo index_mcp moves by up to"),
    (
        partial(wobbling, name="index_mcp", degrees=1.0),
        2,
        "at most 10 times is accepted; does a tendon",
    ),
    (
        partial(wobbling, name="index_mcp", degrees=3.0),
        2,
        "index: the model misses the points by",
        "more than 1°; does a tendon slip",
    ),
    (
        partial(wobbling, name="thumb_cmc", degrees=3.0),
        2,
        "thumb_cmc: the model misses the points by",
    ),
]


@pytest.mark.parametrize(("spoiled", "status", "words"), [(f, k, w) for f, k, *w in SPOILED])
def test_a_spoiled_record_is_told_or_refused(record, calibrate, tmp_path, spoiled, status, words):
    """`hpac sweep` makes the same checks."""
    found, said = calibrate(spoiled(record))
    assert found == status
    assert all(word in (said.err if status else said.out) for word in words)
    assert (tmp_path / "hand.toml").exists() == (status == 0)
