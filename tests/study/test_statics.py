"""The closed-form hand at rest: Eq. (12) where the paper's assumptions hold, balance of torques where they do not."""

from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, elastic_joints_from_servo, rigid_joints_from_servo, scaled_hand
from hpac_gym.study.population import mae_of_population
from hpac_gym.study.reference import varied_hand
from hpac_gym.study.rig import HAND, JointCamera, Rig
from hpac_gym.study.statics import EXTENSION, FLEXION, Friction, digit_statics, settled_joints

SERVO = np.linspace(HPAC.servo_min, HPAC.servo_max, 15)
STIFF_DRIVE = scaled_hand(HPAC, {"drive_stiffness": 1e9})


def test_a_stiff_drive_without_friction_is_the_elastic_model():
    expected = elastic_joints_from_servo(SERVO)
    assert settled_joints(SERVO, replace(STIFF_DRIVE, cmc_stiffness=1e9)) == pytest.approx(expected, abs=1e-8)


def test_stiff_tendons_without_friction_are_the_rigid_model():
    stiff = scaled_hand(STIFF_DRIVE, {"tendon_stiffness": 1e9})
    assert settled_joints(SERVO, stiff) == pytest.approx(rigid_joints_from_servo(SERVO), abs=1e-8)


@pytest.mark.parametrize("digit", HPAC.digits)
@pytest.mark.parametrize("direction", [FLEXION, EXTENSION])
def test_every_joint_is_in_balance(digit, direction):
    """The torques of spring, coupling, drive and friction on every joint add up to nothing, written out joint by joint."""
    p = HPAC.digits[digit]
    friction = Friction(joint=8e-4, tendon=0.03)
    statics = digit_statics(p, friction, direction)
    q = 0.9 * statics.slope + statics.offset
    r = np.array(p.joint_radius)
    spring = p.spring_stiffness * (r * q).sum()
    stretch = r[:-1] * q[:-1] - r[1:] * q[1:]
    stiffness = p.tendon_stiffness / np.array(p.path_length) * ([2, 1] if len(r) == 3 else [1])
    coupling = stiffness * stretch
    before = np.append(coupling, [])
    after = np.append(coupling[1:], 0.0)
    held = friction.joint + friction.tendon * r[1:] * (before + after + spring)
    assert r[1:] * (before - after - spring) == pytest.approx(direction * held, abs=1e-12)
    drive_torque = statics.load_slope * 0.9 + statics.load_offset
    held = friction.joint + friction.tendon * (drive_torque + r[0] * (coupling[0] + spring))
    assert drive_torque - r[0] * (coupling[0] + spring) == pytest.approx(direction * held, abs=1e-12)


def test_drive_stretch_is_tension_over_stiffness():
    """The tendon that the servo winds is the chord's shortening and the stretch of the driving tendon."""
    q = settled_joints(SERVO)
    for column, (name, p) in enumerate(HPAC.digits.items()):
        root = q[:, JOINT_INDEX[p.joints[0]]]
        chord = np.sqrt(p.d1**2 + p.d2**2 - 2 * p.d1 * p.d2 * np.cos(p.alpha - root))
        arm = p.d1 * p.d2 * np.sin(p.alpha - root) / chord
        tension = digit_statics(p).load_slope * root / arm
        wound = p.servo_radius * SERVO[:, column]
        assert wound == pytest.approx(p.rest_chord - chord + tension / p.drive_stiffness, abs=1e-12), name


def test_friction_lags_in_both_directions():
    friction = Friction(joint=1e-3, tendon=0.02)
    middle = settled_joints(SERVO)[3:]
    assert (settled_joints(SERVO, friction=friction)[3:] < middle).all()
    assert (settled_joints(SERVO, friction=friction, direction=EXTENSION)[3:] > middle).all()


def test_a_joint_never_passes_its_stop_at_rest():
    assert (settled_joints(SERVO, friction=Friction(joint=5e-3)) >= 0).all()


@pytest.mark.parametrize("servo", ["index_mcp", "thumb_mp", "thumb_cmc"])
def test_the_physics_settles_where_the_statics_say(servo):
    """PyBullet against the closed form, over a flexion with friction: within the servo's dead band and 0.05°."""
    rig = Rig(settings=replace(HAND, joint_friction=1e-3), camera=JointCamera(noise=0.0, drift=0.0)).with_protocol(
        points=6, seconds_per_point=3.0, rest=0.5
    )
    sweep = rig.sweep(np.random.default_rng(0), servos=(servo,))
    held = (sweep.point >= 0) & (sweep.phase == 1)
    expected = settled_joints(sweep.servo[held], friction=Friction(1e-3))
    column = HPAC.servo_of_joint == ("thumb_mp", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp", "thumb_cmc").index(servo)
    slope = 1.8 * HPAC.elastic_ratio[column].max()  # of a joint against its servo at rest, where it is steepest
    error = np.abs(sweep.joint_pos[held] - expected)[:, column]
    assert error.max() < slope * rig.settings.servo.dead_band + np.deg2rad(0.05)
    assert sweep.joint_pos[held][:, column].max() > 0.9


def test_a_population_has_an_interval_about_its_centre_that_grows_with_the_tolerance():
    narrow = mae_of_population(60, 1, HPAC, Friction(1e-3), {"d2": 1e-4})
    wide = mae_of_population(60, 1, HPAC, Friction(1e-3), {"d2": 1e-3})
    for name in ("index_dip", "thumb_ip"):
        for kind in ("uncompensated", "compensated"):
            value = narrow[kind][name]
            assert value.low < value.median < value.high
            assert wide[kind][name].high - wide[kind][name].low > 3 * (value.high - value.low)
    assert mae_of_population(20, 5, HPAC, Friction()) == mae_of_population(20, 5, HPAC, Friction())


def test_a_varied_hand_is_drawn_digit_by_digit_and_by_seed():
    drawn = [varied_hand(HPAC, {"d1": 0.01, "joint_radius": 0.01}, np.random.default_rng(seed)) for seed in (1, 1, 2)]
    assert drawn[0] == drawn[1] != drawn[2]
    ratios = {name: digit.d1 / HPAC.digits[name].d1 for name, digit in drawn[0].digits.items()}
    assert len(set(ratios.values())) == len(ratios)
    assert drawn[0].digits["index"].alpha == HPAC.digits["index"].alpha
    assert len(JOINTS) == 15
