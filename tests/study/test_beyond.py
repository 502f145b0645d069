"""Beyond the paper: hysteresis, repeatability, tracking and rivals measure what they say, on cases whose answer is known."""

import argparse
import json
from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.model import HPAC, JOINTS
from hpac_gym.study import beyond, rivals, tracking, trials
from hpac_gym.study.accuracy import EVALUATED
from hpac_gym.study.intervals import mean_of
from hpac_gym.study.processing import points
from hpac_gym.study.record import concatenate
from hpac_gym.study.reference import load_reference
from hpac_gym.study.rig import JointCamera, Protocol
from hpac_gym.study.statics import EXTENSION, FLEXION, Friction, settled_joints
from hpac_gym.study.synthetic import synthetic_sweep
from hpac_gym.study.trials import JointTrials

REFERENCE = load_reference()
SERVO = np.linspace(0, 1, 11)


def made_up_trials(width: float, spread: float, count: int = 40) -> JointTrials:
    rng = np.random.default_rng(0)
    flexion = SERVO + spread * rng.standard_normal((count, len(SERVO)))
    return JointTrials(SERVO, flexion, SERVO + width + spread * rng.standard_normal((count, len(SERVO))))


def test_width_and_spread_of_made_up_trials_come_back():
    joints = {"index_dip": made_up_trials(width=0.02, spread=0.005)}
    width, spread = trials.hysteresis_deg(joints)["index_dip"], trials.spread_deg(joints)["index_dip"]
    assert width.low < np.degrees(0.02) < width.high
    assert spread.low < np.degrees(0.005) < spread.high
    assert width.high - width.low < 0.2 * width.mean


def test_the_turning_points_do_not_count_for_the_width():
    joint = made_up_trials(width=0.02, spread=0.0, count=2)
    joint.extension[:, [0, -1]] = 9.0
    assert trials.hysteresis_width(joint) == pytest.approx(0.02)


def test_tendon_friction_gives_the_hysteresis_that_the_balance_of_torques_asks_for():
    """The index in PyBullet against the closed form's two branches, slowly and without noise.

    No wider than that, and most of it: each time that a servo stops, the digit shakes a part of the hysteresis off.
    """
    quiet = replace(REFERENCE.rig, hand=HPAC, camera=JointCamera(noise=0.0, drift=0.0)).with_protocol(
        points=12, seconds_per_point=3.0, rest=0.5, both_directions=True
    )
    settings = replace(REFERENCE.trials, tendon_friction=0.05, friction_spread=0.0, seat=0.0)
    record = trials.run_trials(replace(REFERENCE, rig=quiet, trials=settings), 1, 0, servos=("index_mcp",))
    friction = Friction(REFERENCE.rig.settings.joint_friction, 0.05)
    for name, joint in trials.by_joint(record, REFERENCE.cutoff_hz).items():
        servo = np.zeros((len(joint.servo), 6))
        servo[:, 1] = joint.servo
        column = JOINTS.index(name)
        branches = [settled_joints(servo, HPAC, friction, way)[None, :, column] for way in (FLEXION, EXTENSION)]
        expected = float(trials.hysteresis_width(JointTrials(joint.servo, *branches))[0])
        assert 0.5 * expected < float(trials.hysteresis_width(joint)[0]) < 1.1 * expected
        assert expected > np.deg2rad(0.08)


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.05, 0.2])
def test_lag_of_a_delayed_course_is_its_delay(delay):
    time = np.arange(0, 6, 1 / tracking.SAMPLE_HZ)
    wanted = np.sin(2 * np.pi * 0.5 * time)
    measured = 0.1 + np.sin(2 * np.pi * 0.5 * (time - delay))
    assert tracking.lag(time, wanted, measured) == pytest.approx(delay, abs=1e-3)


def test_profiles_have_period_one_and_reach_both_ends():
    phase = np.linspace(0, 1, 401)
    for profile in tracking.PROFILES.values():
        assert (profile(phase).min(), profile(phase).max()) == pytest.approx((-1, 1))
        assert profile(phase + 1) == pytest.approx(profile(phase), abs=1e-12)
    ends = np.array([0.0, 1e-4, 0.5 - 1e-4, 0.5])
    assert np.diff(tracking.minimum_jerk(ends))[[0, 2]] == pytest.approx(0, abs=1e-9)


def test_a_slow_profile_is_tracked_and_a_later_servo_lags_more():
    found = {}
    for lag in (0.0, 0.05):
        seen = tracking.track(replace(REFERENCE, servo_lag=lag), tracking.sine, 0.5, np.random.default_rng(0))
        column = JOINTS.index("index_dip")
        found[lag] = tracking.lag(seen.time, seen.wanted[:, column], seen.measured[:, column])
        assert np.degrees(np.sqrt(np.mean((seen.measured - seen.wanted)[:, column] ** 2))) < 5
    assert found[0.05] - found[0.0] == pytest.approx(0.05, abs=0.01)


@pytest.fixture(scope="module")
def sweeps():
    """A training and a test sweep of the reference's index and thumb, at rest in closed form."""
    friction = Friction(1e-3)
    protocol = Protocol(points=25)
    return [
        synthetic_sweep(
            REFERENCE.rig.hand, friction, np.random.default_rng(seed), protocol=protocol, servos=("thumb_mp", "index_mcp")
        )
        for seed in (0, 1)
    ]


@pytest.fixture(scope="module")
def rivalry(sweeps):
    return rivals.run_rivals(*sweeps, count=3, seed=0, samples=(4, 16))


def test_the_papers_model_beats_the_rigid_one_untrained(rivalry):
    assert rivalry.untrained["paper's model"] < 0.5 * rivalry.untrained["rigid model"]


def test_more_samples_help_every_rival_that_can_bend(rivalry):
    for name in ("polynomial", "Gaussian process", "network"):
        assert rivalry.trained[name][16].mean < rivalry.trained[name][4].mean


def test_linear_scaling_stays_far_off_whatever_it_is_given(rivalry):
    """The cosine law is no line."""
    assert rivalry.trained["linear scaling"][16].mean > 10 * rivalry.trained["identified"][16].mean


def test_few_samples_are_enough_for_physics_and_not_for_the_others(rivalry):
    assert rivalry.untrained["paper's model"] < min(rivalry.trained[name][4].mean for name in rivals.RIVALS)
    assert 4 not in rivalry.trained["identified"]
    assert rivalry.trained["identified"][16].mean < rivalry.untrained["paper's model"]


def test_rivals_are_the_same_for_the_same_seed(sweeps, rivalry):
    again = rivals.run_rivals(*sweeps, count=3, seed=0, samples=(4,))
    for name in rivals.RIVALS:
        assert again.trained[name][4] == rivalry.trained[name][4]


@pytest.mark.parametrize("name", rivals.RIVALS)
def test_every_rival_learns_a_line_from_noiseless_points(name):
    joint_pos = SERVO[:, None] * np.array([0.8, 1.0])
    predictor = rivals.RIVALS[name](SERVO, joint_pos, np.random.default_rng(0))
    assert predictor(np.array([0.33, 0.77])) == pytest.approx(np.array([[0.264, 0.33], [0.616, 0.77]]), abs=1e-4)


def test_a_mean_has_students_interval():
    found = mean_of([1.0, 2.0, 3.0])
    assert found.mean == 2.0
    assert found.high - 2.0 == pytest.approx(4.302653 / np.sqrt(3))
    assert np.isnan(mean_of([1.0]).low)


@pytest.mark.slow
def test_the_command_writes_the_tables_and_figures_of_all_four(tmp_path, capsys):
    parser = argparse.ArgumentParser()
    beyond.add_arguments(parser)
    assert beyond.run(parser.parse_args(["--quick", "--choices", "2", "--out", str(tmp_path), "--json"])) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result["hysteresis_width_deg"]) == set(JOINTS) == set(result["trial_to_trial_sd_deg"])
    assert {(item["profile"], item["rate_hz"]) for item in result["tracking"]} == {
        (profile, rate) for profile in tracking.PROFILES for rate in (0.5, 1.0)
    }
    assert set(result["tracking"][0]["lag_s"]) == {*EVALUATED, "mean"}
    assert set(result["rivals_mae_deg"]["trained"]) == {*rivals.RIVALS, "identified"}
    written = {path.name for path in tmp_path.iterdir()}
    assert written == {"hysteresis.png", "repeatability.png", "tracking.png", "rivals.png", "study.md", "study.json"}


def test_trials_of_a_record_become_rows_joint_by_joint():
    """Two made-up trials, both directions: every joint of the swept servo has two rows of each, in the order of the points."""
    parts = []
    for trial in (0, 1):
        flexion = synthetic_sweep(HPAC, Friction(), np.random.default_rng(trial), servos=("ring_mcp",))
        held = flexion[flexion.phase == 1]
        extension = replace(held, phase=held.phase + 1, time=held.time + 100.0)
        parts.append(concatenate([held, extension]))
    record = concatenate([parts[0], replace(parts[1], trial=parts[1].trial + 1)])
    joints = trials.by_joint_of_points(points(record))
    assert set(joints) == {"ring_mcp", "ring_pip", "ring_dip"}
    for joint in joints.values():
        assert joint.flexion.shape == joint.extension.shape == (2, len(joint.servo))
        assert (np.diff(joint.servo) > 0).all()
        assert joint.flexion == pytest.approx(joint.extension)
        assert (joint.flexion[0] != joint.flexion[1]).any()
