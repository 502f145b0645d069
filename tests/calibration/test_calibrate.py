"""`hpac calibrate`: what its first line is about, what it doubts, and what it refuses."""

import errno
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hpac
from experiments.bench import JointCamera, Protocol, metal_sweeps
from experiments.quasistatic import hand_course
from hpac_gym.calibration import processing, samples
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
from hpac_gym.output import replacing


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


def test_a_good_sweep_alone_has_no_remark_and_promises_nothing_about_commands(record, calibrate):
    """An interval about a number that another combination explains as well would be a false one."""
    status, said = calibrate(record)
    assert (status, said.err) == (0, "")
    assert "at the held-out points of the same sweep (an error of camera or servos" in said.out
    assert "Remark" not in said.out
    assert "| effective number | formula | design | found | determined by the data |" in said.out
    assert "Effective g_CMC" in said.out
    assert "interval |" not in said.out
    assert "with 95 % confidence" not in said.out


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


def test_a_report_that_cannot_be_written_leaves_the_hand_file_as_it_was(
    nominal_record, calibrate, tmp_path
):
    (tmp_path / "hand-report" / "report.json").mkdir(parents=True)
    (tmp_path / "hand.toml").write_text("as it was")
    status, said = calibrate(nominal_record)
    assert (status, said.out) == (2, "")
    assert f"error: cannot write '{tmp_path / 'hand-report' / 'report.json'}'" in said.err
    assert (tmp_path / "hand.toml").read_text() == "as it was"


@pytest.mark.parametrize("full", ["report.json", "fit.png"])
def test_a_full_disk_leaves_all_files_of_the_last_calibration(
    nominal_record, calibrate, tmp_path, monkeypatch, full
):
    """A new report beside an old hand file would be read as that file's."""
    assert calibrate(nominal_record)[0] == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    other = nominal_record.with_joint_pos(1.01 * nominal_record.joint_pos)
    writes = Path.write_text

    def fails(path, *words, **options):
        if path.stem.startswith(f".{Path(full).stem}-") and path.suffix == Path(full).suffix:
            raise OSError(errno.ENOSPC, "No space left on device")
        return writes(path, *words, **options)

    def drawn(_, path, __):
        with replacing(path) as temporary:
            temporary.write_text("a figure")

    monkeypatch.setattr(Path, "write_text", fails)
    monkeypatch.setattr("hpac_gym.calibration.calibrate.save", drawn)
    status, said = calibrate(other)
    assert status == 2
    place = tmp_path / "hand-report" / full
    assert said.err == f"error: cannot write '{place}': No space left on device\n"
    after = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    sweep = tmp_path / "sweep.csv"
    assert before.pop(sweep) != after.pop(sweep)
    assert after == before


def test_a_sweep_is_no_check_on_itself(record, calibrate, tmp_path):
    status, said = calibrate(record, second=record)
    assert status == 2
    assert "second.csv is the same sweep; it must be a second one" in said.err
    assert not (tmp_path / "hand.toml").exists()


def test_a_check_measures_every_joint_that_the_sweep_does(record, calibrate, tmp_path, monkeypatch):
    """What the file does to the other joints would be in no bound."""
    monkeypatch.delattr("hpac_gym.calibration.calibrate.identify")
    second = record[record.swept != SERVOS.index("thumb_mp")]
    status, said = calibrate(record, second=with_last_rest(second, 0.01))
    assert (status, said.out) == (2, "")
    assert "second.csv does not measure thumb_ip, thumb_mp: its bound is" in said.err


def test_a_second_sweep_is_what_the_first_line_is_about(record, second, calibrate, tmp_path):
    status, said = calibrate(record, second=second)
    assert status == 0
    report = json.loads((tmp_path / "hand-report" / "report.json").read_text())
    worst = report["expected_worst_deg"]
    assert max(error["mean_abs_deg"] for error in report["file_error"].values()) / 2 < worst < 0.2
    assert report["bound_95_deg"] == pytest.approx(BOUND * worst)
    first = said.out.splitlines()[2]
    assert first.startswith("Judged on the independent sweep second.csv, commands with")
    assert f"by {worst:.2f}° at the worst joint" in first
    assert first.endswith(f"with 95 % confidence by at most {BOUND * worst:.2f}°.")
    assert json.loads(calibrate(record, "--json")[1].out)["bound_95_deg"] is None


def test_the_expected_worst_joint_lies_between_the_largest_and_what_all_joints_let_expect():
    errors = {str(i): FileError(error, 1.0, 0.1, 9) for i, error in enumerate([0.1] * 3 + [0.8])}
    rms = np.sqrt((3 * 0.01 + 0.64) / 4)
    assert expected_worst_deg(errors) == pytest.approx(np.sqrt(0.8 * WORST_OF_JOINTS * rms))
    alike = {str(i): FileError(0.3, 1.0, 0.1, 9) for i in range(4)}
    assert expected_worst_deg(alike) == pytest.approx(0.3 * np.sqrt(WORST_OF_JOINTS))


def test_an_error_of_the_first_camera_shows_in_the_second_sweep_alone(
    record, second, calibrate, tmp_path
):
    """The reason for a second one: a camera whose scale is 3 % off fits itself."""
    wrong = record.with_joint_pos(1.03 * record.joint_pos)
    alone = _worst(calibrate(wrong)[1].out)
    checked = _worst(calibrate(wrong, second=second)[1].out)
    assert alone < 0.15
    assert checked > 5 * alone


def _worst(out):
    return float(out.partition("on average and ")[2].partition("°")[0].removeprefix("by "))


@pytest.mark.parametrize(("slip_deg", "status"), [(1.7, 0), (2.5, 2)])
def test_a_tendon_that_slips_half_way_is_doubted_or_refused(record, calibrate, slip_deg, status):
    late = (record.swept == 1) & (record.servo[:, 1] > 0.5 * HPAC.servo_max[1])
    slipped = record.joint_pos - np.deg2rad(slip_deg) * late[:, None]
    found, said = calibrate(record.with_joint_pos(slipped))
    assert found == status
    assert "index: the points scatter" in said.out + said.err
    assert ("at most 10 times is accepted" in said.err) == (status == 2)


def test_a_stop_of_the_cmc_is_told_and_ends_the_files_workspace(record, calibrate, tmp_path):
    column = JOINT_INDEX["thumb_cmc"]
    digits = record[np.isin(record.swept, (1, 5))]
    stopped = digits.joint_pos.copy()
    stopped[digits.swept == 5, column] = np.minimum(stopped[digits.swept == 5, column], 1.1)
    status, said = calibrate(digits.with_joint_pos(stopped))
    assert status == 0
    assert "thumb_cmc rests at 1.100 rad" in said.out
    hand = load_hand(tmp_path / "hand.toml")
    assert hand.workspace["thumb_cmc"][1] == pytest.approx(1.1, abs=1e-3)
    assert hand.sources["workspace"].endswith("up to the stops in sweep.csv")


def of_index(record):
    return record[record.swept == SERVOS.index("index_mcp")]


def with_last_rest(record, degrees):
    """A digit that does not come back to its stops."""
    last = (record.phase == REST) & (record.time > record.time[record.phase == FLEXING].max())
    return record.with_joint_pos(record.joint_pos + np.deg2rad(degrees) * last[:, None])


def test_rests_that_differ_are_told_and_bend_no_curve(record, hidden, calibrate, monkeypatch):
    """With a straight line through both rests, the control, the file is off by more than 1°."""
    index = of_index(record)
    spoiled = with_last_rest(index, 2.0)
    status, said = calibrate(spoiled)
    assert status == 0
    assert "the rests of index_dip, index_pip, index_mcp differ by up to 1.9°" in said.out

    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 17)
    joints = [JOINT_INDEX[name] for name in HPAC.digits["index"].joints]
    truth = hand_course([hidden], servo)[0]

    def error():
        off = settled_joints_from_servo(servo, identify(spoiled).hand) - truth
        return np.degrees(np.abs(off[:, joints])).mean(axis=0).max()

    assert error() < 0.2
    for module in (samples, processing):
        monkeypatch.setattr(module, "differing_rests", lambda segment: {})
    assert error() > 1


def test_a_drift_between_rests_that_differ_is_fitted_in_both_directions(hidden):
    """The camera turned by 2° in the course of the sweep: the way back tells it from the geometry."""
    both = metal_sweeps(
        [hidden], 1, protocol=Protocol(both_directions=True), servos=("index_mcp",)
    )[0]
    drift = np.deg2rad(2.0) * (both.time - both.time[0]) / np.ptp(both.time)
    turned = both.with_joint_pos(both.joint_pos + drift[:, None])
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 17)
    joints = [JOINT_INDEX[name] for name in HPAC.digits["index"].joints]
    identified = identify(turned)
    sources = named(identified, HPAC, "one.csv").sources
    assert (
        sources["d2"] == "identified from one.csv, about H-PAC; thumb, middle, ring, pinky as there"
    )
    assert sources["cmc_gain"] == HPAC.sources["cmc_gain"]
    off = settled_joints_from_servo(servo, identified.hand) - hand_course([hidden], servo)[0]
    assert np.degrees(np.abs(off[:, joints])).mean(axis=0).max() < 0.15


@pytest.mark.parametrize("both_directions", [False, True])
def test_rests_that_differ_by_a_cameras_drift_are_not_told(hidden, both_directions):
    """Three standard deviations of the usual drift, in a short record and in a long one."""
    protocol = Protocol(both_directions=both_directions)
    steady = JointCamera(drift=0.0)
    record = metal_sweeps([hidden], 1, steady, protocol, servos=("index_mcp",))[0]
    drift = np.deg2rad(0.6) / 60 * record.time[:, None]
    assert not [
        x for x in judged(record.with_joint_pos(record.joint_pos + drift), HPAC) if "rests" in x
    ]


def test_a_camera_that_is_not_square_shows_in_the_second_sweep(record, hidden, calibrate, tmp_path):
    """Alone, the fit takes most of it for geometry, and tells the rest as scatter."""
    second = metal_sweeps([hidden], 2, servos=("index_mcp",))[0]
    index = of_index(record)
    askew = index.with_joint_pos(index.joint_pos + np.deg2rad(2.5) * np.sin(2 * index.joint_pos))
    alone = calibrate(askew)[1].out
    assert "the points scatter" in alone
    _, said = calibrate(askew, second=second)
    assert _worst(said.out) > 2.5 * _worst(alone)
    assert "the two sweeps differ by more than 1.5° in" in said.out


def test_a_check_that_measures_more_contradicts_nothing(hidden, calibrate):
    """What the first sweep does not have keeps the design's numbers, which no sweep contradicts."""
    first, second = (
        metal_sweeps([hidden], seed, servos=("index_mcp", "middle_mcp")) for seed in (1, 2)
    )
    status, said = calibrate(of_index(first[0]), second=second[0])
    assert status == 0
    assert "Judged on" in said.out
    assert "middle_pip" not in said.out.partition("Remark")[2]
    assert "the two sweeps differ" not in said.out


def as_a_share(record):
    return replace(record, servo=record.servo / HPAC.servo_max)


def one_point_ahead(record):
    """Every servo then seems to have a zero of one step; a hand's own zeros differ."""
    held = (record.phase == FLEXING) & (record.point >= 0)
    servo = record.servo.copy()
    for column, top in enumerate(HPAC.servo_max):
        rows = held & (record.swept == column)
        step = (top - HPAC.servo_min[column]) / record.point.max()
        servo[rows, column] = np.minimum(servo[rows, column] + step, top)
    return replace(record, servo=servo)


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


def wobbling(record):
    """With an amplitude of 1°, from point to point, for all joints."""
    index = of_index(record)
    wobble = np.deg2rad(1.0) * np.sin(2.4 * index.point) * (index.point >= 0)
    return index.with_joint_pos(index.joint_pos + wobble[:, None])


def wobbling_widely(record):
    """So that the index would have no fit; the middle finger is well."""
    digits = record[np.isin(record.swept, (1, 2))]
    wobble = np.deg2rad(3.0) * np.sin(2.4 * digits.point) * (digits.point >= 0)
    return digits.with_joint_pos(digits.joint_pos + (wobble * (digits.swept == 1))[:, None])


def wobbling_cmc(record):
    """Its joint is driven without a tendon, and its fit is another one."""
    digits = record[np.isin(record.swept, (1, 5))]
    wobble = np.deg2rad(3.0) * np.sin(2.4 * digits.point) * (digits.point >= 0)
    return digits.with_joint_pos(digits.joint_pos + (wobble * (digits.swept == 5))[:, None])


def root_scaled(record):
    """All other joints of the digit then turn too little for it."""
    index = of_index(record)
    scale = np.where(np.arange(index.joint_pos.shape[1]) == JOINT_INDEX["index_mcp"], 1.1, 1.0)
    return index.with_joint_pos(scale * index.joint_pos)


def one_number(record):
    point = np.where((record.phase == FLEXING) & (record.point >= 0), 0, record.point)
    return replace(record, point=point)


SPOILED = {
    as_a_share: (
        "standard deviations from the design; are the servo's angles in radians",
        "off the design's 1.000, and no tendon is between",
    ),
    one_point_ahead: (
        "the zeros of all 6 servos are about -0.9 steps of the sweep",
        "one point ahead of the angles?",
    ),
    markers_exchanged: (
        "points of index_pip lie up to 6° beside the course of the others",
        "were markers exchanged for a while?",
    ),
    root_scaled: (
        "index: all joints turn -",
        "is the scale of the root joint's angle off, or its radius?",
    ),
    later: ("servo index_mcp moves by up to",),
    wobbling: ("does a tendon slip, or a camera wobble?",),
    wobbling_widely: ("index: the model misses the points by", "more than 1°; does a tendon slip"),
    wobbling_cmc: ("thumb_cmc: the model misses the points by",),
    one_number: ("has each place no number of its own?",),
}
REFUSED = (later, wobbling, wobbling_widely, wobbling_cmc, one_number)


@pytest.mark.parametrize("spoiled", SPOILED)
def test_a_spoiled_record_is_told_or_refused(record, calibrate, spoiled):
    """`hpac sweep` makes the same checks."""
    status, said = calibrate(spoiled(record))
    assert status == (2 if spoiled in REFUSED else 0)
    assert all(words in (said.err if status else said.out) for words in SPOILED[spoiled])
