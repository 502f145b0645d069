"""The tendons' torques, without a simulator."""

import numpy as np
import pytest

from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    elastic_joints_from_servo,
    joints_from_synergy,
    spring_tension,
)
from hpac_gym.physics.settings import Damping
from hpac_gym.physics.tendons import COUPLINGS, Tendons, element_rows

DT = 1 / 240
REST = np.zeros(15)


@pytest.fixture(scope="module")
def tendons() -> Tendons:
    return Tendons(HPAC, np.eye(15) * 1e-3, DT, Damping())


def non_root_joints() -> list[int]:
    return [JOINT_INDEX[name] for digit in HPAC.digits.values() for name in digit.joints[1:]]


def test_static_equilibrium_of_the_coupling_is_equations_12_and_13(tendons):
    """On the elastic manifold coupling and spring leave no torque on any IP, PIP or DIP; with the
    same stiffness in both segments of a finger, without the factor two, they would leave 0.03 N·m.
    """
    for share in np.linspace(0.05, 1.0, 20):
        joints = joints_from_synergy(share * HPAC.synergy_max)
        torque, _ = tendons.torque(joints, REST, np.zeros(6), np.zeros(6))
        assert np.abs(np.array(torque)[non_root_joints()]).max() < 1e-12


def test_springs_pull_with_the_tension_of_equation_10():
    joints = joints_from_synergy(HPAC.synergy_max * 0.7)
    rows, stiffness = element_rows(HPAC)
    found = (stiffness * (rows @ joints))[COUPLINGS:]
    np.testing.assert_allclose(found, spring_tension(joints), rtol=1e-12)


def test_a_servo_pulls_no_harder_than_it_can_and_never_pushes(tendons):
    joints = joints_from_synergy(HPAC.synergy_max * 0.5)
    _, slack = tendons.torque(joints, REST, np.zeros(6), np.zeros(6))
    np.testing.assert_array_equal(slack, 0.0)
    torque, taut = tendons.torque(REST, REST, HPAC.servo_max, np.zeros(6))
    np.testing.assert_array_equal(taut, [digit.tension_limit for digit in HPAC.digits.values()])
    assert torque[JOINT_INDEX["thumb_cmc"]] == HPAC.cmc_torque_limit


def test_moment_arm_is_the_slope_of_the_chord(tendons):
    """Virtual work: dchord/dq = −arm, with arm = d1 d2 sin(alpha − q)/chord."""
    step = 1e-6
    for drive, root in zip(tendons.drives, HPAC.synergy_max[:5] * 0.6, strict=True):
        _, arm = drive.chord_and_arm(root)
        (ahead, _) = drive.chord_and_arm(root + step)
        (behind, _) = drive.chord_and_arm(root - step)
        assert arm == pytest.approx((behind - ahead) / (2 * step), rel=1e-8)


def test_a_drive_at_the_rigid_angle_is_neither_taut_nor_slack(tendons):
    servo = HPAC.servo_max * 0.6
    joints = elastic_joints_from_servo(servo)
    _, tension = tendons.torque(joints, REST, servo + 1e-6, np.zeros(6))
    expected = [1e-6 * digit.servo_radius * digit.drive_stiffness for digit in HPAC.digits.values()]
    np.testing.assert_allclose(tension, expected, rtol=1e-6)


def test_a_slack_drive_brakes_only_a_finger_that_overruns_its_servo(tendons):
    """Flexion faster than the servo's is damped; following the servo, opening and standing still
    are free.
    """
    drive = tendons.drives[1]
    angle = 0.5
    _, arm = drive.chord_and_arm(angle)
    horn_speed = 2.0
    following = horn_speed * drive.servo_radius / arm
    assert drive.tension(angle, following + 1.0, 0.0, horn_speed)[0] == pytest.approx(
        -drive.brake * arm
    )
    for speed in (following, 0.5 * following, 0.0, -3.0):
        assert drive.tension(angle, speed, 0.0, horn_speed)[0] == pytest.approx(0.0, abs=1e-9)
