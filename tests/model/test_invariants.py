"""What holds for every posture and every hand: inverses, monotony, limits, slopes, scaling."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from hpac_gym.model import (
    HPAC,
    SERVOS,
    action_from_synergy,
    clip_synergy,
    clip_to_workspace,
    elastic_deviation,
    elastic_joints_from_servo,
    joints_from_synergy,
    move_duration,
    rigid_joints_from_servo,
    scaled_hand,
    servo_from_action,
    servo_from_joints,
    servo_from_synergy,
    stream_command,
    synergy_from_action,
    synergy_from_joints,
    synergy_from_servo,
    transmission_matrix,
)

actions = arrays(float, 6, elements=st.floats(-1, 1))
synergies = arrays(float, 6, elements=st.floats(0, 1)).map(lambda share: share * HPAC.synergy_max)
factors = st.floats(0.8, 1.25)


@pytest.mark.parametrize(
    ("there", "back"),
    [
        (servo_from_synergy, synergy_from_servo),
        (action_from_synergy, synergy_from_action),
        (joints_from_synergy, synergy_from_joints),
    ],
)
@given(synergies)
def test_a_synergy_comes_back_from_servo_action_and_posture(there, back, synergy):
    assert back(there(synergy)) == pytest.approx(synergy, abs=1e-12)


def test_table_1_box_is_wider_than_the_servo_range():
    """At Table I's upper corner the projection passes the servos' range in each finger, and the
    limit brings it back.
    """
    assert (synergy_from_joints(HPAC.joint_max)[1:5] > HPAC.synergy_max[1:5]).all()
    assert servo_from_joints(HPAC.joint_max)[1:5] == pytest.approx(HPAC.servo_max[1:5], abs=0)


@given(arrays(float, 6, elements=st.floats(-10, 10)))
def test_clip_synergy_is_idempotent_and_gives_admissible_servos(synergy):
    clipped = clip_synergy(synergy)
    assert (clip_synergy(clipped) == clipped).all()
    servo = servo_from_synergy(clipped)
    assert (servo >= HPAC.servo_min).all()
    assert (servo <= HPAC.servo_max).all()


@given(actions)
def test_servo_from_action_is_its_four_steps(action):
    posture = joints_from_synergy(synergy_from_action(action))
    assert servo_from_action(action) == pytest.approx(
        servo_from_joints(clip_to_workspace(posture)), abs=1e-12
    )


def test_every_joint_is_monotone_in_its_servo():
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 1000)
    for forward in (rigid_joints_from_servo, elastic_joints_from_servo):
        assert (np.diff(forward(servo), axis=0) > 0).all()


def test_slope_at_rest_is_the_limit_of_h():
    """H(0) against a central difference of q(u): r L0 / (d1 d2 sin α), times the ratio."""
    step = 1e-6
    for column in range(len(SERVOS)):
        ahead = np.zeros(6)
        behind = np.zeros(6)
        ahead[column] = step
        behind[column] = -step
        slope = (rigid_joints_from_servo(ahead) - rigid_joints_from_servo(behind)) / (2 * step)
        assert transmission_matrix(np.zeros(6))[:, column] == pytest.approx(slope, rel=1e-8)


def test_h_is_continuous_at_rest():
    at_rest = transmission_matrix(np.zeros(6))
    for servo in (1e-9, 0.99e-7, 1.01e-7, 1e-6, 1e-5):
        assert transmission_matrix(np.full(6, servo)) == pytest.approx(at_rest, rel=2e-5, abs=1e-15)


def test_elastic_becomes_rigid_as_the_tendon_stiffens():
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 50)
    rigid = rigid_joints_from_servo(servo)
    hands = [scaled_hand(HPAC, {"tendon_stiffness": by}) for by in (1, 1e2, 1e4, 1e6)]
    gaps = [np.abs(elastic_joints_from_servo(servo, hand) - rigid).max() for hand in hands]
    assert (np.diff(gaps) < 0).all()
    assert gaps[-1] < 1e-7
    assert gaps[1] / gaps[2] == pytest.approx(100, rel=0.01)


@given(factors, factors, factors)
def test_inverse_holds_for_any_hand(guide, spring, radius):
    hand = scaled_hand(HPAC, {"d2": guide, "spring_stiffness": spring, "joint_radius": radius})
    servo = hand.servo_min + 0.6 * (hand.servo_max - hand.servo_min)
    posture = clip_to_workspace(elastic_joints_from_servo(servo, hand), hand)
    if (posture == elastic_joints_from_servo(servo, hand)).all():
        assert servo_from_joints(posture, hand) == pytest.approx(servo, abs=1e-12)


@pytest.mark.parametrize("shape", [(), (1,), (4,), (2, 3), (0,)])
def test_any_leading_shape(shape):
    rng = np.random.default_rng(3)
    action = rng.uniform(-1, 1, (*shape, 6))
    posture = joints_from_synergy(synergy_from_action(action))
    assert posture.shape == (*shape, 15)
    assert transmission_matrix(synergy_from_action(action)).shape == (*shape, 15, 6)
    servo = servo_from_joints(posture)
    assert servo.shape == servo_from_action(action).shape == (*shape, 6)
    for index in np.ndindex(shape):
        assert servo[index] == pytest.approx(servo_from_joints(posture[index]), abs=1e-14)


@pytest.mark.parametrize("function", [synergy_from_joints, elastic_deviation])
def test_a_product_is_the_same_to_the_bit_in_any_batch(function):
    postures = np.random.default_rng(4).uniform(HPAC.joint_min, HPAC.joint_max, (200, 15))
    np.testing.assert_array_equal(function(postures), [function(one) for one in postures])


@given(synergies, synergies)
def test_move_duration_is_the_slowest_servo_at_its_rate(start, end):
    start = servo_from_synergy(start)
    end = servo_from_synergy(end)
    assert move_duration(start, end) == pytest.approx(max(abs(end - start)) / HPAC.rate_limit)
    assert move_duration(start, end) == move_duration(end, start)
    assert move_duration(start, start) == 0


@given(synergies, synergies, st.floats(0.01, 0.5))
def test_streamed_commands_arrive_together_at_the_rate_limit(start, end, period):
    servo = servo_from_synergy(start)
    target = servo_from_synergy(end)
    steps = int(np.ceil(move_duration(servo, target) / period - 1e-9))
    for _ in range(max(steps, 1)):
        command = stream_command(servo, target, period)
        assert command.duration == period
        assert (abs(command.servo - servo) <= HPAC.servo_rate_limit * period + 1e-12).all()
        remaining = target - servo
        travel = command.servo - servo
        assert abs(remaining * travel.max() - travel * remaining.max()).max() < 1e-9
        servo = command.servo
    assert servo == pytest.approx(target, abs=1e-9)


@pytest.mark.parametrize(
    ("function", "width", "number"),
    [
        (servo_from_action, 6, 0.25),
        (synergy_from_action, 6, 0.25),
        (servo_from_joints, 15, 0.25),
        (clip_to_workspace, 15, -0.25),
        (clip_synergy, 6, -0.25),
        (joints_from_synergy, 6, 0.25),
        (synergy_from_servo, 6, 0.25),
        (partial(stream_command, target=HPAC.servo_max, period=0.05), 6, 0.25),
    ],
)
def test_no_function_writes_into_its_argument(function, width, number):
    given = np.full(width, number)
    function(given)
    assert (given == number).all()
