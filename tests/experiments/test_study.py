"""Beyond the paper: hysteresis, repeatability, tracking and rivals measure what they say, on cases
whose answer is known.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments import commands, populations, rivals, study, tracking, trials
from experiments.bench import JointCamera, Protocol, metal_sweeps
from experiments.quasistatic import Built, Metal, hand_course
from experiments.results import Column, Part, mean_of, range_of, rows_of, table
from experiments.rig import NEAR_STOP, rig_of
from experiments.sweep import Reference
from experiments.trials import JointTrials
from hpac_gym.calibration.accuracy import EVALUATED
from hpac_gym.calibration.processing import points, processed
from hpac_gym.calibration.record import concatenate, joints_of_servo
from hpac_gym.figures import label
from hpac_gym.model import HPAC, JOINTS, Calibration, Friction
from hpac_gym.model.settled import EXTENSION, FLEXION, settled_joints_from_servo

REFERENCE = Reference.of()
SERVO = np.linspace(0, 1, 11)
WIDTH = 0.02
"""Hysteresis of the made-up trials [rad]."""


def made_up_trials(spread: float, count: int = 40) -> JointTrials:
    rng = np.random.default_rng(0)
    flexion = SERVO + spread * rng.standard_normal((count, len(SERVO)))
    return JointTrials(
        SERVO, flexion, SERVO + WIDTH + spread * rng.standard_normal((count, len(SERVO)))
    )


def test_width_and_spread_of_made_up_trials_come_back():
    joints = {"index_dip": made_up_trials(spread=0.005)}
    width, spread = rows_of(trials.COLUMNS, joints)["index_dip"].values()
    assert width.low < np.degrees(WIDTH) < width.high
    assert spread.low < np.degrees(0.005) < spread.high
    assert width.high - width.low < 0.2 * width.middle


def test_the_turning_points_do_not_count_for_the_width():
    joint = made_up_trials(spread=0.0, count=2)
    joint.extension[:, [0, -1]] = 9.0
    assert trials.hysteresis_width(joint) == pytest.approx(WIDTH)


@pytest.mark.slow
@pytest.mark.pybullet  # MuJoCo knows no friction by load
def test_tendon_friction_gives_the_hysteresis_that_the_balance_of_torques_asks_for():
    """The index in PyBullet against the closed form's two branches, slowly and without noise.

    No wider than that, and most of it: each time that a servo stops, the digit shakes a part of the
    hysteresis off."""
    quiet = replace(
        REFERENCE.rig, hand=HPAC, camera=JointCamera(noise=0.0, drift=0.0)
    ).with_protocol(points=12, seconds_per_point=3.0, rest=0.5, both_directions=True)
    rubbing = replace(REFERENCE, rig=quiet, tendon_friction=0.05, friction_spread=0.0)
    record = trials.run_trials(rubbing, 1, 0, servos=("index_mcp",))
    friction = Friction(REFERENCE.rig.settings.joint_friction, 0.05)
    for name, joint in trials.by_joint(points(processed(record))).items():
        servo = np.zeros((len(joint.servo), 6))
        servo[:, 1] = joint.servo
        column = JOINTS.index(name)
        frictional = replace(HPAC, calibration=Calibration(friction=(friction,) * 5))
        branches = [
            settled_joints_from_servo(servo, frictional, way)[None, :, column]
            for way in (FLEXION, EXTENSION)
        ]
        expected = float(trials.hysteresis_width(JointTrials(joint.servo, *branches))[0])
        assert 0.5 * expected < float(trials.hysteresis_width(joint)[0]) < 1.1 * expected
        assert expected > np.deg2rad(0.08)


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.05, 0.2])
def test_lag_of_a_delayed_course_is_its_delay(delay):
    time = np.arange(0, 6, 1 / 80)
    wanted = np.sin(2 * np.pi * 0.5 * time)
    measured = 0.1 + np.sin(2 * np.pi * 0.5 * (time - delay))
    assert tracking.lag(time, wanted, measured) == pytest.approx(delay, abs=1e-3)


def test_profiles_have_period_one_and_reach_both_ends():
    phase = np.linspace(0, 1, 401)
    for profile in tracking.PROFILES.values():
        assert (profile(phase).min(), profile(phase).max()) == pytest.approx((-1, 1))
        assert profile(phase + 1) == pytest.approx(profile(phase), abs=1e-12)
    ends = np.array([0.0, 1e-4, 0.5 - 1e-4, 0.5])
    assert np.diff(tracking.back_and_forth(ends))[[0, 2]] == pytest.approx(0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.pybullet  # MuJoCo knows no friction by load
def test_a_slow_profile_is_tracked_and_a_later_servo_lags_more():
    found = {}
    for late in (0.0, 0.05):
        seen = tracking.track(
            replace(REFERENCE, servo_lag=late), tracking.sine, 0.5, np.random.default_rng(0)
        )
        column = JOINTS.index("index_dip")
        found[late] = tracking.lag(seen.time, seen.wanted[:, column], seen.measured[:, column])
        assert np.degrees(np.sqrt(np.mean((seen.measured - seen.wanted)[:, column] ** 2))) < 5
    assert found[0.05] - found[0.0] == pytest.approx(0.05, abs=0.01)


@pytest.mark.slow
@pytest.mark.pybullet  # MuJoCo knows no friction by load
def test_the_camera_in_the_loop_halves_the_error_and_without_learning_it_does_not(monkeypatch):
    def rms() -> float:
        seen = tracking.track(REFERENCE, tracking.sine, 0.25, np.random.default_rng(0), closed=True)
        columns = [JOINTS.index(name) for name in EVALUATED]
        return float(np.degrees(np.sqrt(np.mean((seen.measured - seen.wanted)[:, columns] ** 2))))

    closed = rms()
    monkeypatch.setattr(tracking.Observer, "update", lambda self, error, rate: None)
    assert closed < 0.5 * rms()


def test_the_observer_takes_out_a_lag_and_an_offset_of_either_direction():
    """Less than half of what lag and offsets make is left after some periods; without one of the
    gains more is.
    """

    def left_over(**gains: float) -> float:
        observer = tracking.Observer(**gains)
        errors = []
        for speed in np.cos(np.arange(0, 60, 0.05)):
            offset = 0.02 if speed >= 0 else -0.01
            error = offset - observer.offset[int(speed < 0)] - (0.03 - observer.lag) * speed
            errors.append(np.abs(error).mean())
            observer.update(error, np.full(5, speed))
        return float(np.mean(errors[-126:]))

    untaught = left_over(lag_gain=0.0, offset_gain=0.0)
    assert left_over() < 0.5 * untaught
    assert left_over() < min(left_over(lag_gain=0.0), left_over(offset_gain=0.0))


@pytest.mark.slow
def test_four_points_are_enough_for_fitted_physics_even_where_its_laws_are_wrong():
    """More points help every rival that can bend; linear scaling stays far off, because the cosine
    law is no line.
    """
    race = rivals.run_race(1, 0, samples=(4, 16))
    fitted = {number: found.middle for number, found in race.trained["`hpac calibrate`"].items()}
    assert fitted[4] < min(race.trained[name][4].middle for name in rivals.RIVALS)
    assert fitted[4] < min(value.middle for value in race.untrained.values())
    assert race.trained["linear scaling"][16].middle > 10 * fitted[16]
    for name in ("polynomial", "Gaussian process", "network"):
        assert race.trained[name][16].middle < race.trained[name][4].middle


@pytest.mark.slow
def test_hands_in_mujoco_rest_where_the_quasi_static_simulation_lets_them():
    """One hand, without the effects that the engine lacks; dynamics and its one friction for all
    digits are the difference.
    """
    (hand,) = populations.build(rivals.OTHER_METAL, 1, 0)
    plain = Built(
        hand.hand, tuple(replace(item, guide_radius=0.0, cable_friction=0.0) for item in hand.metal)
    )
    record, servo, truth = rig_of(hand, "mujoco").seen_and_true(rivals.COMMON_ERRORS, 0)
    stopped = truth > HPAC.joint_max - NEAR_STOP
    for joints in map(joints_of_servo, range(5)):
        truth[np.ix_(stopped[:, joints].any(axis=1), joints)] = np.nan
    error = np.degrees(np.abs(truth - hand_course([plain], servo)[0]))[:, populations.NINE]
    assert np.isnan(error).mean() < 0.1
    assert np.nanmean(error) < 0.15
    assert np.nanmean(np.degrees(np.abs(record.joint_pos)).max(axis=0)) > 40
    as_assumed = Built(hand.hand, tuple(replace(item, first_segment=2.0) for item in plain.metal))
    assert (
        np.nanmean(
            np.degrees(np.abs(truth - hand_course([as_assumed], servo)[0]))[:, populations.NINE]
        )
        > 0.4
    )


@pytest.mark.parametrize("name", rivals.RIVALS)
def test_every_rival_learns_a_line_from_noiseless_points(name):
    joint_pos = SERVO[:, None] * np.array([0.8, 1.0])

    def model(angle: np.ndarray) -> np.ndarray:
        return angle[:, None] * np.array([0.7, 1.1])

    predictor = rivals.RIVALS[name](SERVO, joint_pos, np.random.default_rng(0), model)
    assert predictor(np.array([0.33, 0.77])) == pytest.approx(
        np.array([[0.264, 0.33], [0.616, 0.77]]), abs=2e-4
    )


def test_a_mean_has_students_interval():
    found = mean_of([1.0, 2.0, 3.0])
    assert found.middle == 2.0
    assert found.high - 2.0 == pytest.approx(4.302653 / np.sqrt(3))
    assert np.isnan(mean_of([1.0]).low)


@pytest.mark.slow
def test_one_sweep_brings_all_nine_joints_within_the_goal_and_the_way_back_needs_its_friction():
    maps = (*commands.BEFORE_AND_AFTER, "… friction of flexion both ways")
    before, after, one_way = commands.commands(
        "", populations.WORKSHOPS[study.COMMANDED], 3, 7, maps
    ).data.values()
    assert before["all_within_goal"] == before["all_within_goal_back"] == 0.0
    assert after["all_within_goal"] == after["all_within_goal_back"] == 1.0
    assert one_way["extension_worst"].middle > 5 * after["extension_worst"].middle


def test_hands_of_a_workshop_are_drawn_one_by_one_and_spread_with_its_tolerance():
    narrow, wide = (
        populations.build(populations.Workshop(populations.geometry(size)), 3, 1)
        for size in (1e-3, 1e-2)
    )
    assert narrow[:2] == populations.build(populations.Workshop(populations.geometry(1e-3)), 2, 1)
    off = [
        abs(built[0].hand.digits["ring"].d2 / HPAC.digits["ring"].d2 - 1)
        for built in (narrow, wide)
    ]
    assert off[1] == pytest.approx(10 * off[0])
    assert len({digit.d1 for digit in wide[0].hand.digits.values()}) == 5


def test_a_population_tells_what_compensation_makes_worse():
    """Made-up errors: of two hands with nine joints one joint is worse with compensation, and one
    hand is good.
    """
    before = np.full((2, 9), 1.0)
    after = np.full((2, 9), 0.1)
    after[1, 4] = 1.5
    errors = populations.PopulationErrors(before, after, np.zeros((2, 5)))
    row = rows_of(populations.COLUMNS, {"hands": errors})["hands"]
    assert row["made_worse"] == pytest.approx(1 / 18)
    assert row["all_below"] == 0.5
    assert row["worst_joint"].middle == pytest.approx(0.8)


def test_a_table_shows_every_number_in_its_form_and_keeps_it_whole_for_programs():
    middle = Column("middle", "middle [°]", range_of, "{:.2f}")
    columns = (middle, Column("share", "beyond 1", lambda x: float((x > 1).mean()), "{:.0%}"))
    rows = rows_of(columns, {"first": np.array([0.5, 1.5, 1.5]), "second": np.zeros(2)})
    assert rows["first"]["share"] == pytest.approx(2 / 3)
    head, rule, first, second = table("hands", columns, rows).splitlines()
    assert (head, rule) == ("| hands | middle [°] | beyond 1 |", "| --- | --- | --- |")
    assert first == "| first | 1.50 [0.55, 1.50] | 67% |"
    assert second == "| second | 0.00 [0.00, 0.00] | 0% |"


@pytest.mark.parametrize("words", [[], ["all"], ["tracking", "causes"]])
def test_each_part_that_is_named_writes_table_and_numbers_and_without_one_all_are_run(
    words, tmp_path, monkeypatch
):
    made = []
    parts = {name: lambda _, name=name: made.append(name) or Part(name, {}) for name in study.PARTS}
    monkeypatch.setattr(study, "PARTS", parts)
    study.main([*words, "--out", str(tmp_path)])
    assert made == (words if len(words) == 2 else list(parts))
    written = {f"{name}.{kind}" for name in made for kind in ("md", "json")}
    assert {path.name for path in tmp_path.iterdir()} == written


@pytest.mark.slow
@pytest.mark.pybullet  # MuJoCo knows no friction by load
def test_the_command_runs_every_part(tmp_path):
    study.main(["--hands", "3", "--quick", "--out", str(tmp_path)])
    result = {path.stem: json.loads(path.read_text()) for path in tmp_path.glob("*.json")}
    assert set(result) == set(study.PARTS)
    assert set(result["trials"]) == {label(name) for name in JOINTS}
    assert "reference hand, 5 trials, seed 0" in (tmp_path / "hysteresis.svg").read_text()
    assert {(item["profile"], item["closed"]) for item in result["tracking"]} == {
        (profile, closed) for profile in tracking.PROFILES for closed in (False, True)
    }


def test_trials_of_a_record_become_rows_joint_by_joint():
    """Two trials, both directions: every joint of the swept servo has two rows of each, in the
    order of the points.
    """
    plain = Built(HPAC, (Metal(),) * 5)
    first, second = metal_sweeps(
        [plain] * 2, 0, protocol=Protocol(points=9, both_directions=True), servos=("ring_mcp",)
    )
    record = concatenate([first, replace(second, trial=second.trial + 1)])
    joints = trials.by_joint(points(record))
    assert set(joints) == {"ring_mcp", "ring_pip", "ring_dip"}
    for joint in joints.values():
        assert joint.flexion.shape == joint.extension.shape == (2, len(joint.servo))
        assert (np.diff(joint.servo) > 0).all()
        # The drift is not taken out.
        assert joint.flexion == pytest.approx(joint.extension, abs=0.03)
        assert (joint.flexion[0] != joint.flexion[1]).any()
