"""The closed-form hand at rest: Eq. (12) where the paper's assumptions hold, balance of torques
where they do not.
"""

from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    Hand,
    clip_to_workspace,
    elastic_joints_from_servo,
    hand_to_toml,
    joints_from_synergy,
    scaled_hand,
    servo_from_joints,
)
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.files import hand_from_toml
from hpac_gym.model.settled import (
    EXTENSION,
    FLEXION,
    digit_statics,
    settled_joints_from_servo,
    settled_servo_from_joints,
)

SERVO = np.linspace(HPAC.servo_min, HPAC.servo_max, 15)
STIFF_DRIVE = scaled_hand(HPAC, {"drive_stiffness": 1e9})


def test_a_stiff_drive_without_friction_is_the_elastic_model():
    expected = elastic_joints_from_servo(SERVO)
    assert settled_joints_from_servo(SERVO, STIFF_DRIVE) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("digit", HPAC.digits)
@pytest.mark.parametrize("direction", [FLEXION, EXTENSION])
def test_every_joint_is_in_balance(digit, direction):
    """The torques of spring, coupling, drive and friction on every joint add up to nothing, written
    out joint by joint.
    """
    p = HPAC.digits[digit]
    friction = Friction(joint=8e-4, tendon=0.03)
    statics = digit_statics(p, friction, direction)
    q = 0.9 * statics.slope + statics.offset
    r = np.array(p.joint_radius)
    spring = p.spring_stiffness * (r * q).sum()
    stretch = r[:-1] * q[:-1] - r[1:] * q[1:]
    stiffness = p.tendon_stiffness / np.array(p.path_length) * ([2, 1] if len(r) == 3 else [1])
    assert p.segment_stiffness == pytest.approx(stiffness)
    coupling = stiffness * stretch
    before = np.append(coupling, [])
    after = np.append(coupling[1:], 0.0)
    held = friction.joint + friction.tendon * r[1:] * (before + after + spring)
    assert r[1:] * (before - after - spring) == pytest.approx(direction * held, abs=1e-12)
    drive_torque = statics.load_slope * 0.9 + statics.load_offset
    held = friction.joint + friction.tendon * (drive_torque + r[0] * (coupling[0] + spring))
    assert drive_torque - r[0] * (coupling[0] + spring) == pytest.approx(
        direction * held, abs=1e-12
    )


def test_drive_stretch_is_tension_over_stiffness():
    """The tendon that the servo winds is the chord's shortening and the stretch of the driving
    tendon.
    """
    q = settled_joints_from_servo(SERVO)
    for column, (name, p) in enumerate(HPAC.digits.items()):
        root = q[:, JOINT_INDEX[p.joints[0]]]
        chord = np.sqrt(p.d1**2 + p.d2**2 - 2 * p.d1 * p.d2 * np.cos(p.alpha - root))
        arm = p.d1 * p.d2 * np.sin(p.alpha - root) / chord
        tension = digit_statics(p).load_slope * root / arm
        wound = p.servo_radius * SERVO[:, column]
        assert wound == pytest.approx(
            p.rest_chord - chord + tension / p.drive_stiffness, abs=1e-12
        ), name


def with_friction(friction: Friction) -> Hand:
    return replace(HPAC, calibration=Calibration(friction=(friction,) * 5))


def test_friction_lags_in_both_directions():
    middle = settled_joints_from_servo(SERVO)[3:, :-1]
    frictional = with_friction(Friction(1e-3, 0.02))
    assert (settled_joints_from_servo(SERVO, frictional)[3:, :-1] < middle).all()
    assert (settled_joints_from_servo(SERVO, frictional, EXTENSION)[3:, :-1] > middle).all()


def test_a_joint_never_passes_its_stop_at_rest():
    assert (settled_joints_from_servo(SERVO, with_friction(Friction(joint=5e-3))) >= 0).all()


def test_a_servos_zero_is_an_angle_that_its_command_lacks():
    zero = tuple(np.deg2rad([0.5, -0.5, 1.0, 0.0, 0.3, -0.2]))
    turned = replace(HPAC, calibration=Calibration(zero))
    assert settled_joints_from_servo(SERVO[3:] - zero, turned) == pytest.approx(
        settled_joints_from_servo(SERVO[3:]), abs=1e-12
    )


ZEROS = tuple(np.deg2rad([0.5, -0.5, 1.0, 0.0, 0.3, -0.2]).tolist())
FRICTIONS = (Friction(1e-3, 0.03), Friction(2e-3), Friction(1e-3, 0.03), Friction(2e-3), Friction())
CALIBRATED = replace(HPAC, calibration=Calibration(ZEROS, FRICTIONS))


@pytest.mark.parametrize("direction", [FLEXION, EXTENSION])
def test_the_calibrated_command_brings_the_hand_where_it_rests(direction):
    """It is the exact inverse on the postures in which the hand comes to rest."""
    inside = 0.1 + 0.8 * (SERVO - HPAC.servo_min)
    resting = settled_joints_from_servo(inside, CALIBRATED, direction)
    servo = settled_servo_from_joints(clip_to_workspace(resting, CALIBRATED), CALIBRATED, direction)
    assert servo == pytest.approx(inside, abs=1e-9)


def test_the_calibrated_command_of_a_hand_without_any_of_it_is_eq_15():
    posture = joints_from_synergy(HPAC.synergy_min + 0.7 * (HPAC.synergy_max - HPAC.synergy_min))
    assert settled_servo_from_joints(posture, STIFF_DRIVE) == pytest.approx(
        servo_from_joints(posture), abs=1e-6
    )


CALIBRATION_FAULTS = [
    ("servo_zero = [", "servo_zero = [0.1, ", r"servo_zero = .* rad must be 6 values within"),
    ("joint_friction = [0.001", "joint_friction = [-0.001", "joint = -0.001 N·m must be a number"),
    ("joint_friction = [0.001", "joint_friction = [1000.0", r"joint = 1000.0 N·m must be .*, 1\]"),
    (
        "tendon_friction = [0.03, ",
        "tendon_friction = [",
        r"\[calibration\] tendon_friction = \[.*\] must be 5 numbers",
    ),
    ("tendon_friction = [0.03", "tendon_friction = [1.0", r"tendon = 1.0 must be .* \[0, 0.999\]"),
    ("servo_zero = [0.0", "servo_zero = [-5.0", r"servo_zero = .* rad must be 6 values within"),
    (
        "[calibration]",
        "[calibration]\nwear = 1",
        r"\[calibration\] is missing or does not know wear",
    ),
]


@pytest.mark.parametrize(("good", "bad", "message"), CALIBRATION_FAULTS)
def test_a_faulty_calibration_is_told(good, bad, message):
    text = hand_to_toml(CALIBRATED)
    assert good in text
    with pytest.raises(ParameterError, match=message):
        hand_from_toml(text.replace(good, bad, 1), "text")
