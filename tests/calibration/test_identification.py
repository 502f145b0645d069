"""Identification, proved on hidden hands in metal: the written file is near the truth, its
intervals hold it as they say.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments.bench import JointCamera, Protocol, metal_sweeps
from experiments.hidden import (
    COLUMNS,
    COVERAGE,
    LAWS,
    HiddenHand,
    run_hidden,
    run_hidden_in_physics,
    swept_digit,
)
from experiments.quasistatic import Built, Metal, hand_course
from experiments.results import rows_of
from hpac_gym.calibration import calibrate
from hpac_gym.calibration.combinations import SweptDigit, digit_with, values
from hpac_gym.calibration.fitting import IdentificationError
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.record import REST, Sweep, concatenate, write_sweep
from hpac_gym.calibration.report import file_errors
from hpac_gym.calibration.samples import digit_samples, held_out_rows
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVOS,
    elastic_joints_from_servo,
    load_hand,
    servo_from_joints,
)
from hpac_gym.model.settled import (
    EXTENSION,
    digit_statics,
    settled_digit,
    settled_joints_from_servo,
)
from tests.calibration.conftest import of_servos
from tests.options import called

SERVO = np.linspace(HPAC.servo_min, HPAC.servo_max, 17)
INDEX = [JOINT_INDEX[name] for name in HPAC.digits["index"].joints]


def truth_of(built: Built) -> np.ndarray:
    """Where a hand in metal rests at `SERVO`, shape (17, 15) [rad]."""
    return hand_course([built], SERVO)[0]


def spoiled(record: Sweep, **changes) -> Sweep:
    joint_pos = record.joint_pos.copy()
    for joint, (rows, value) in changes.items():
        joint_pos[rows, JOINT_INDEX[joint]] = value
    return record.with_joint_pos(joint_pos)


@pytest.fixture(scope="module")
def found(record):
    return identify(record)


def test_the_identified_hand_is_within_a_tenth_of_a_degree_of_the_truth(hidden, found):
    """Every joint, and the servos' zeros within a quarter; the nominal hand is degrees off."""
    truth = truth_of(hidden)
    assert np.degrees(np.abs(settled_joints_from_servo(SERVO, found.hand) - truth).max()) < 0.1
    assert np.degrees(np.abs(elastic_joints_from_servo(SERVO) - truth).max()) > 2
    zeros = [metal.servo_zero - metal.dead_band for metal in hidden.metal]
    assert found.cmc[0].low < 1 < found.cmc[0].high
    assert found.cmc[1].low < 0 < found.cmc[1].high
    assert found.hand.calibration.servo_zero[:5] == pytest.approx(zeros, abs=np.deg2rad(0.25))


def test_a_horn_one_tooth_off_is_found():
    """A tooth of the spline is 14.4°; with a prior of 1° the fit would end at its bound of 4°."""
    built = Built(HPAC, (Metal(servo_zero=np.deg2rad(-14.4)),) * 5)
    found = identify(metal_sweeps([built], 3, servos=("index_mcp",))[0])
    assert np.degrees(found.hand.calibration.servo_zero[1]) == pytest.approx(-14.4, abs=0.2)
    error = np.abs(settled_joints_from_servo(SERVO, found.hand) - truth_of(built))
    assert np.degrees(error[:, INDEX].max()) < 0.1


def summarised(hands: list[HiddenHand]) -> dict:
    return rows_of((*COLUMNS, *COVERAGE), {"hands": hands})["hands"]


def coverage(draws: int, seed: int) -> dict:
    return summarised(run_hidden(draws, seed, "laws of the fit"))


def test_hidden_hands_meet_the_marks_and_their_intervals_hold_the_truth():
    """±20 % stiffness, ±5 % geometry, zeros, frictions, stops, 2 % of outliers and of dropped
    frames; not the fit's solver.
    """
    found = coverage(1, seed=11)
    assert found["refused"] == found["stops_missed"] == 0
    assert found["within"] == 1.0
    assert min(found["coverage"].values()) >= 0.8  # of 5 digits; the slow test takes 300


@pytest.mark.slow
def test_95_percent_intervals_hold_the_truth_in_90_percent_of_the_digits():
    found = coverage(60, seed=12)
    assert min(found["coverage"].values()) >= 0.9, found["coverage"]
    assert np.mean(list(found["coverage"].values())) >= 0.95
    assert found["worst_deg"] < 0.1


@pytest.mark.slow
def test_the_intervals_hold_for_soft_servos(monkeypatch):
    """No record tells a servo's compliance from the guides' geometry, so the intervals must allow
    for one of 8 N·m/rad.
    """
    monkeypatch.setitem(
        LAWS, "laws of the fit", replace(LAWS["laws of the fit"], servo_stiffness=8.0)
    )
    found = coverage(20, seed=13)["coverage"]
    assert min(found[name] for name in ("hub", "reach", "alpha", "drive_stretch")) >= 0.9, found


@pytest.mark.slow
def test_other_laws_than_the_fits_are_still_met_within_the_marks():
    found = summarised(run_hidden(20, 5, "other laws"))
    assert found["refused"] == 0
    assert found["within"] >= 0.95
    assert not found["coverage"]


@pytest.mark.slow
@pytest.mark.pybullet  # MuJoCo knows no friction by load
def test_a_hidden_hand_in_the_physics_engine_meets_the_marks():
    found = summarised(run_hidden_in_physics(1, 3))
    assert found["refused"] == 0
    assert found["within"] == 1.0


def test_what_the_data_tells_is_told_and_what_not_too(found):
    for name, fit in found.fits.items():
        told = {item.name: item.told for item in fit.estimates}
        assert min(told["hub"], told["alpha"], told["servo_zero"]) > 0.9, name
        assert told["ip_strain" if name == "thumb" else "pip_strain"] < 0.2


def test_known_radii_let_the_elasticity_be_told(nominal_record):
    fit = identify(nominal_record, radii_known=True).fits["index"]
    found = {item.name: item for item in fit.estimates}
    assert found["pip_strain"].told > 0.5
    assert (
        found["pip_strain"].low
        < values(SweptDigit(HPAC.digits["index"]))[5]
        < found["pip_strain"].high
    )


def test_radii_that_are_not_what_was_said_are_told(nominal_record):
    """A PIP ratio that is off by 3 % would need a strain that no tendon has."""
    off = 0.97 * nominal_record.joint_pos[:, JOINT_INDEX["index_pip"]]
    with pytest.raises(
        IdentificationError,
        match=r"index: .* --radii-known: R_MCP/R_PIP would be 0\.99\d\d times the design's, beyond 0\.9970 to 1\.0030 times",
    ):
        identify(spoiled(nominal_record, index_pip=(slice(None), off)), radii_known=True)


def test_angles_depend_on_the_combinations_alone(hidden):
    """A hidden digit and the one rebuilt from its combinations about the nominal hand rest at the
    same angles.
    """
    horn = np.linspace(0.05, 1.3, 9)
    for column, name in enumerate(HPAC.digits):
        swept = swept_digit(hidden, column)
        one = digit_with(HPAC.digits[name], values(swept))
        expected = settled_digit(horn, swept.digit, swept.friction)
        assert settled_digit(horn, one.digit, one.friction) == pytest.approx(expected, abs=1e-9)


def test_missing_joints_and_rows_still_give_a_fit(hidden, record):
    rng = np.random.default_rng(4)
    gone = spoiled(record, index_dip=(slice(None), np.nan), ring_mcp=(slice(None), np.nan))
    gone = spoiled(gone, middle_pip=(rng.random(len(record)) < 0.3, np.nan))
    found = identify(gone[(rng.random(len(record)) < 0.8) & np.isin(record.swept, (1, 2, 3))])
    assert found.fits["index"].samples.missing == ("index_dip",)
    assert set(found.kept) == {"thumb", "pinky", "thumb_cmc"}
    assert "while servo pinky_mcp sweeps" in found.kept["pinky"]
    assert found.hand.digits["pinky"] == HPAC.digits["pinky"]
    told = {item.name: item.told for item in found.fits["index"].estimates}
    assert told["dip_ratio"] < 0.05 < 0.9 < told["pip_ratio"]
    error = np.abs(settled_joints_from_servo(SERVO, found.hand) - truth_of(hidden))
    assert np.degrees(error[:, [JOINT_INDEX["middle_pip"], JOINT_INDEX["ring_dip"]]].max()) < 0.15


@pytest.mark.filterwarnings("error")
def test_points_that_do_not_show_a_joint_are_taken_without_a_warning(record):
    hidden = spoiled(record, index_dip=(record.point == 5, np.nan))
    hidden = spoiled(hidden, index_pip=(record.point % 2 == 0, np.nan))
    samples = digit_samples(hidden, SERVOS.index("index_mcp"))
    assert np.isnan(samples.joint_pos).sum(axis=0).tolist() == [0, 16, 1]


def test_outliers_are_counted_and_hardly_move_the_fit(hidden, record):
    rng = np.random.default_rng(6)
    hit = (rng.random(len(record)) < 0.05) & (record.phase == 1)
    noisy = spoiled(
        record, index_pip=(hit, 0.1), index_dip=(np.roll(hit, 7) & (record.phase == 1), 1.4)
    )
    found = identify(noisy[noisy.swept == 1])
    assert found.fits["index"].samples.outliers > 5
    error = np.abs(settled_joints_from_servo(SERVO, found.hand) - truth_of(hidden))
    assert np.degrees(error[:, INDEX].max()) < 0.1


def with_stop(angle: float) -> Built:
    """The nominal hand with a stop of the index DIP."""
    return Built(HPAC, (Metal(), Metal(stop=(9.0, 9.0, angle)), *(Metal(),) * 3))


def test_a_stop_is_found_left_out_and_written_into_the_workspace(nominal_record):
    """The index DIP stops at 0.9 rad, the MCP goes on: one mechanism up to there, another one
    beyond.
    """
    found = identify(metal_sweeps([with_stop(0.9)], 3, servos=("index_mcp",))[0])
    samples = found.fits["index"].samples
    assert samples.stops == {"index_dip": pytest.approx(0.9, abs=2e-3)}
    assert samples.at_stops >= 8
    assert found.hand.workspace["index_dip"][1] == pytest.approx(0.9, abs=2e-3)
    reached = truth_of(with_stop(0.9))
    free = reached[:, JOINT_INDEX["index_dip"]] < 0.9
    assert (
        np.degrees(
            np.abs(settled_joints_from_servo(SERVO, found.hand) - reached)[
                np.ix_(free, INDEX)
            ].max()
        )
        < 0.12
    )
    assert found.hand.synergy_max[1] == pytest.approx(
        0.9 / digit_statics(HPAC.digits["index"]).slope[2], abs=2e-3
    )
    assert not identify(nominal_record).fits["index"].samples.stops


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("zero", [-1.0, -0.3, 0.3])
def test_a_stop_is_found_wherever_the_servo_has_its_zero(zero):
    """Beyond the design's range of the servo, and past the guides, where the design says nothing."""
    stopped = metal_sweeps([with_stop(1.1)], 3, servos=("index_mcp",))[0]
    there = digit_samples(stopped, 1)
    turned = replace(stopped, servo=stopped.servo + zero * np.eye(6)[1])
    here = digit_samples(turned, 1)
    assert here.stops == there.stops == {"index_dip": pytest.approx(1.1, abs=2e-3)}
    assert here.at_stops == there.at_stops >= 3


def test_no_point_at_which_a_joint_rests_at_a_stop_is_fitted():
    """Wherever the DIP meets its stop within a step of 2.4°, at most a tenth of the last step
    before it is lost.
    """
    stops = np.deg2rad(np.arange(68.0, 73.0, 0.25))
    records = metal_sweeps([*map(with_stop, stops)], 3, servos=("index_mcp",))
    for stop, stopped in zip(stops, records, strict=True):
        samples = digit_samples(stopped, 1)
        sweep = np.zeros((len(samples.servo), 6))
        sweep[:, 1] = samples.servo
        free = settled_joints_from_servo(sweep, HPAC)[:, JOINT_INDEX["index_dip"]]
        assert np.degrees(free.max() - stop) < 0.25, np.degrees(stop)


@pytest.mark.slow
def test_both_directions_tell_friction_that_one_cannot():
    metal = (Metal(joint_friction=2e-3, tendon_friction=0.06),) * 5
    built = [Built(HPAC, metal)]
    protocols = (Protocol(both_directions=way) for way in (False, True))
    one, both = (
        identify(metal_sweeps(built, 0, protocol=protocol, servos=("index_mcp",))[0])
        for protocol in protocols
    )
    told = [
        {item.name: item.told for item in found.fits["index"].estimates} for found in (one, both)
    ]
    assert told[1]["tendon_friction"] > 0.5 > told[0]["tendon_friction"]
    assert both.hand.calibration.friction[1].joint == pytest.approx(2e-3, rel=0.3)
    back = hand_course(built, np.concatenate([SERVO, SERVO[::-1]]))[0][17:]
    error = settled_joints_from_servo(SERVO[::-1], both.hand, EXTENSION) - back
    assert np.degrees(np.abs(error[3:13, INDEX]).max()) < 0.15


@pytest.mark.parametrize(
    ("taken", "message"),
    [
        (
            5,
            "supports no fit: .*index: 5 sampling points of .*index_mcp are measured, fewer than 8",
        ),
        (9, "index: servo index_mcp sweeps 27% of its range, less than 30%"),
        (0, "no measurement of index_mcp, index_pip, index_dip"),
    ],
)
def test_a_record_that_supports_no_fit_is_told(record, taken, message):
    """Whether the points are not in the record, or their joints are not seen."""
    index = of_servos(record, "index_mcp")
    seen = index.point < taken if taken else np.zeros(len(index), dtype=bool)
    unseen = index.with_joint_pos(np.where(seen[:, None], index.joint_pos, np.nan))
    for record in (unseen, index[seen]) if taken else (unseen,):
        with pytest.raises(IdentificationError, match=message):
            identify(record)


def test_a_spread_beyond_its_bounds_is_told(record):
    with pytest.raises(IdentificationError, match=r"spread = 0\.0 must lie between 0 and 1"):
        identify(record, spread=0.0)


def test_the_command_writes_a_hand_that_drops_in_and_reports_that_files_error(
    hidden, record, tmp_path, capsys, monkeypatch
):
    """Of one sweep alone it promises nothing about commands: an interval about a number that another
    combination explains as well would be a false one.
    """
    monkeypatch.setattr(calibrate, "DRAWS", 2)
    write_sweep(tmp_path / "sweep.csv", record)
    out = tmp_path / "hand.toml"
    assert called(calibrate, tmp_path / "sweep.csv", "--out", out, "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert set(printed["digits"]) == set(HPAC.digits)
    assert printed["digits"]["index"]["effective_numbers"]["hub"]["told"] > 0.9
    assert printed["bound_95_deg"] is None
    hand = load_hand(out)
    assert hand.sources["d2"].startswith("identified from sweep.csv")
    assert any(hand.calibration.servo_zero)
    servo = hand.servo_min + 0.5 * (hand.servo_max - hand.servo_min)
    assert servo_from_joints(elastic_joints_from_servo(servo, hand), hand) == pytest.approx(servo)
    error = np.abs(settled_joints_from_servo(SERVO, hand) - truth_of(hidden))
    assert np.degrees(error[:, :-1].mean()) < 0.05
    assert set(printed["file_error"]) == set(JOINTS)
    for name, error in printed["file_error"].items():
        assert error["points"] >= 7, name
        assert error["mean_abs_deg"] < 0.1
    folder = tmp_path / "hand-report"
    files = {"report.md", "report.json", "draws.json", "fit.png", "fit.svg"}
    assert {path.name for path in folder.iterdir()} == files
    report = (folder / "report.md").read_text()
    assert "The numbers are effective ones" in report
    assert "at the held-out points of the same sweep (an error of camera or servos" in report
    assert "| effective number | formula | design | found | determined by the data |" in report
    assert "Effective g_CMC" in report
    for absent in ("Remark", "interval |", "with 95 % confidence"):
        assert absent not in report


def test_the_reported_error_is_the_files_and_not_the_fits(record):
    """A file that is tampered with after the fit is reported worse: the negative control of the
    error that is reported.
    """
    found = identify(record[np.isin(record.swept, (1, 3, 5))], hold_out=True)
    honest = file_errors(found, found.hand)
    off = replace(
        found.hand.digits["ring"], servo_radius=1.01 * found.hand.digits["ring"].servo_radius
    )
    tampered = file_errors(found, replace(found.hand, digits={**found.hand.digits, "ring": off}))
    assert tampered["ring_pip"].mean_abs_deg > honest["ring_pip"].mean_abs_deg + 0.3
    assert tampered["index_pip"] == honest["index_pip"]
    geared = file_errors(found, replace(found.hand, cmc_gain=1.01 * found.hand.cmc_gain))
    assert geared["thumb_cmc"].mean_abs_deg > honest["thumb_cmc"].mean_abs_deg + 0.3


def test_held_out_points_are_no_part_of_the_fit(record):
    """Other measurements at the held-out points leave the file as it is."""
    found = []
    for shifted in (None, 2, 1):
        moved = (record.phase == 1) & (record.point % 4 == shifted)
        other = record.with_joint_pos(record.joint_pos + 0.005 * moved[:, None])
        index = other[record.swept == 1]
        found.append(values(identify(index, hold_out=True).fits["index"].swept))
    assert found[1] == pytest.approx(found[0], rel=1e-3)
    assert found[2] != pytest.approx(found[0], rel=1e-3)


@pytest.mark.parametrize("first", [0, 2])
def test_every_fourth_point_is_held_out_however_they_are_numbered(record, first):
    index = record[record.swept == 1]
    number = np.where(index.point >= 0, 4 * index.point + first, -1)
    samples = digit_samples(replace(index, point=number), 1)
    assert held_out_rows(samples).sum() == pytest.approx(len(samples.servo) / 4, abs=1)


def test_every_trial_has_a_drift_of_its_own_and_two_tell_more_than_one(hidden):
    """Cameras that turned to opposite sides, and a digit that did not come back."""
    trials = []
    for trial, turned in enumerate(np.deg2rad([0.6, -0.6])):
        (one,) = metal_sweeps([hidden], trial + 1, JointCamera(), servos=("index_mcp",))
        drift = turned * (one.time - one.time[0]) / np.ptp(one.time)
        drift += np.deg2rad(1.5) * ((one.phase == REST) & (one.time > one.time.mean()))
        moved = one.with_joint_pos(one.joint_pos + drift[:, None])
        trials.append(replace(moved, trial=one.trial + trial))
    alone, both = (identify(sweep).fits["index"] for sweep in (trials[0], concatenate(trials)))
    assert max(alone.misfit, both.misfit) < 2
    assert (len(alone.samples.servo), len(both.samples.servo)) == (31, 62)
    widths = [fit.estimates[0].high - fit.estimates[0].low for fit in (alone, both)]
    assert widths[1] < widths[0]
