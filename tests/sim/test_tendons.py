"""The tendons' torques, without a simulator."""

import numpy as np
import pytest

from hpac_gym.model import HPAC, JOINT_INDEX, SERVOS, elastic_joints_from_servo, joints_from_synergy, spring_tension
from hpac_gym.sim.tendons import Damping, Tendons, coupling_rows, spring_rows

DT = 1 / 240
REST = np.zeros(15)


@pytest.fixture(scope="module")
def tendons() -> Tendons:
    return Tendons(HPAC, np.eye(15) * 1e-3, DT, Damping())


def non_root_joints() -> list[int]:
    return [JOINT_INDEX[name] for digit in HPAC.digits.values() for name in digit.joints[1:]]


def test_static_equilibrium_of_the_coupling_is_equations_12_and_13(tendons):
    """On the elastic manifold coupling and spring leave no torque on any IP, PIP or DIP."""
    for share in np.linspace(0.05, 1.0, 20):
        joints = joints_from_synergy(share * HPAC.synergy_max)
        torque, _ = tendons.torque(joints, REST, np.zeros(6), np.zeros(6))
        assert np.abs(torque[non_root_joints()]).max() < 1e-12


def test_a_tendon_of_equal_stiffness_in_both_finger_segments_would_miss_equation_12():
    """The factor two of a finger's first segment is what makes the physics agree with the paper."""
    rows, stiffness = coupling_rows(HPAC)
    springs, spring_stiffness = spring_rows(HPAC)
    stiffness[1] /= 2
    matrix = rows.T @ (stiffness[:, None] * rows) + springs.T @ (spring_stiffness[:, None] * springs)
    torque = matrix @ joints_from_synergy(HPAC.synergy_max)
    assert np.abs(torque[JOINT_INDEX["index_pip"]]) > 1e-3


def test_springs_pull_with_the_tension_of_equation_10():
    joints = joints_from_synergy(HPAC.synergy_max * 0.7)
    rows, stiffness = spring_rows(HPAC)
    np.testing.assert_allclose(stiffness * (rows @ joints), spring_tension(joints), rtol=1e-12)


def test_a_drive_pulls_and_never_pushes(tendons):
    joints = joints_from_synergy(HPAC.synergy_max * 0.5)
    tension, _ = tendons.drive_tension(joints, REST, np.zeros(6), np.zeros(6))
    np.testing.assert_array_equal(tension, 0.0)


def test_a_drive_pulls_no_harder_than_its_servo(tendons):
    tension, _ = tendons.drive_tension(REST, REST, HPAC.servo_max, np.zeros(6))
    np.testing.assert_array_equal(tension, [digit.tension_limit for digit in HPAC.digits.values()])


def test_a_slack_drive_has_no_damping(tendons):
    joints = joints_from_synergy(HPAC.synergy_max * 0.5)
    still = tendons.drive_tension(joints, REST, np.zeros(6), np.zeros(6))[0]
    moving = tendons.drive_tension(joints, REST, np.zeros(6), np.full(6, 5.0))[0]
    np.testing.assert_array_equal(still, moving)


def test_moment_arm_is_the_slope_of_the_chord(tendons):
    """Virtual work: dchord/dq = −arm, with arm = d1 d2 sin(alpha − q)/chord."""
    root, step = HPAC.synergy_max[:5] * 0.6, 1e-6
    arm, _ = tendons._arm_and_chord(root)
    _, ahead = tendons._arm_and_chord(root + step)
    _, behind = tendons._arm_and_chord(root - step)
    np.testing.assert_allclose(arm, (behind - ahead) / (2 * step), rtol=1e-8)


def test_a_drive_at_the_rigid_angle_is_neither_taut_nor_slack(tendons):
    servo = HPAC.servo_max * 0.6
    joints = elastic_joints_from_servo(servo)
    tension, _ = tendons.drive_tension(joints, REST, servo + 1e-6, np.zeros(6))
    expected = [1e-6 * digit.servo_radius * digit.drive_stiffness for digit in HPAC.digits.values()]
    np.testing.assert_allclose(tension, expected, rtol=1e-6)


def test_cmc_torque_saturates_at_the_stall_torque(tendons):
    torque, _ = tendons.torque(REST, REST, HPAC.servo_max, np.zeros(6))
    assert torque[JOINT_INDEX["thumb_cmc"]] == HPAC.cmc_torque_limit
    assert SERVOS[-1] == "thumb_cmc"


def test_negative_damping_is_refused():
    with pytest.raises(ValueError, match="-1"):
        Damping(joint=-1.0)
