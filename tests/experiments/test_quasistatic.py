"""Hands in metal: the second physics agrees with the closed form and the paper where their
assumptions hold, not elsewhere.
"""

from dataclasses import asdict, replace

import numpy as np
import pytest

from experiments import quasistatic
from experiments.quasistatic import Built, Metal, SettleError, follow, hand_course
from experiments.rig import rig_of
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    Calibration,
    Friction,
    elastic_joints_from_servo,
    rigid_joints_from_servo,
    scaled_hand,
)
from hpac_gym.model.settled import EXTENSION, settled_joints_from_servo

SERVO = np.linspace(HPAC.servo_min, HPAC.servo_max, 21)
STIFF_DRIVE = scaled_hand(HPAC, {"drive_stiffness": 1e4})
FRICTIONAL = replace(HPAC, calibration=Calibration(friction=(Friction(1e-3, 0.03),) * 5))
CLOSE = 2e-6
"""What the solver leaves [rad]."""


SWEPT = (0, 1)
"""Thumb and index: the other fingers differ from the index in numbers alone."""


def course(hand=HPAC, servo=SERVO, **metal) -> np.ndarray:
    return hand_course([Built(hand, (Metal(**metal),) * 5)], servo, servos=SWEPT)[0]


def swept(joint_pos: np.ndarray) -> np.ndarray:
    """The joints of thumb and index, shape (..., 5)."""
    return joint_pos[
        ...,
        [JOINT_INDEX[name] for digit in ("thumb", "index") for name in HPAC.digits[digit].joints],
    ]


def test_with_the_papers_assumptions_it_is_the_papers_model():
    assert swept(course(STIFF_DRIVE)) == pytest.approx(
        swept(elastic_joints_from_servo(SERVO)), abs=CLOSE
    )
    rigid = course(scaled_hand(STIFF_DRIVE, {"tendon_stiffness": 1e4}))
    assert swept(rigid) == pytest.approx(swept(rigid_joints_from_servo(SERVO)), abs=1e-5)


@pytest.fixture(scope="module")
def nominal():
    """The course of the nominal hand."""
    return course()


def test_drive_stretch_and_friction_are_those_of_the_closed_form(nominal):
    assert swept(nominal) == pytest.approx(swept(settled_joints_from_servo(SERVO)), abs=CLOSE)
    found = course(joint_friction=1e-3, tendon_friction=0.03)
    assert swept(found) == pytest.approx(
        swept(settled_joints_from_servo(SERVO, FRICTIONAL)), abs=CLOSE
    )


def test_friction_is_remembered_where_a_motion_turns():
    """Just after the turn a joint has hardly moved; well after it, it lags as the closed form of
    extension says.
    """
    turn = SERVO[-1] - np.linspace(0.0, 2e-3, 3)[1:, None]
    path = np.concatenate([SERVO, turn, SERVO[-2::-1]])
    found = course(servo=path, joint_friction=1e-3, tendon_friction=0.03)
    free = settled_joints_from_servo(turn, FRICTIONAL, EXTENSION)
    dip = JOINT_INDEX["index_dip"]
    assert found[22, dip] == pytest.approx(found[20, dip], abs=1e-5)
    assert free[-1, dip] - found[22, dip] > 1e-3
    back = settled_joints_from_servo(SERVO[-2::-1], FRICTIONAL, EXTENSION)
    assert swept(found[28:39]) == pytest.approx(swept(back[5:16]), abs=1e-5)


def test_ea_over_l_in_both_segments_is_not_eq_12():
    """0.75° in the PIP and 0.60° in the DIP: what the factor two in a finger's first segment is
    worth.
    """
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 41)
    plain = course(STIFF_DRIVE, servo, first_segment=1.0)
    error = np.degrees(np.abs(plain - elastic_joints_from_servo(servo)).mean(axis=0))
    assert error[JOINT_INDEX["index_pip"]] == pytest.approx(0.75, abs=0.01)
    assert error[JOINT_INDEX["index_dip"]] == pytest.approx(0.60, abs=0.01)
    assert error[[JOINT_INDEX["thumb_ip"], JOINT_INDEX["index_mcp"]]] == pytest.approx(0, abs=1e-3)


def test_a_servo_that_gives_way_is_a_softer_drive():
    digit = HPAC.digits["index"]
    softer = replace(
        digit, drive_stiffness=1 / (1 / digit.drive_stiffness + digit.servo_radius**2 / 20.0)
    )
    hand = replace(HPAC, digits={**HPAC.digits, "index": softer})
    fingers = [JOINT_INDEX[name] for name in digit.joints]
    assert course(servo_stiffness=20.0)[:, fingers] == pytest.approx(
        course(hand)[:, fingers], abs=CLOSE
    )


def test_a_hand_in_metal_is_the_same_hand_in_an_engine():
    """EA/L in both segments and a servo that gives way become a longer path and a softer drive of
    the engine's hand.
    """
    metal = Metal(first_segment=1.0, servo_stiffness=20.0, servo_zero=0.01)
    rig = rig_of(Built(HPAC, (metal,) * 5))
    found = settled_joints_from_servo(SERVO + np.array(rig.servo_zero), rig.hand)
    assert swept(course(**asdict(metal))) == pytest.approx(swept(found), abs=CLOSE)
    assert np.degrees(np.abs(swept(found - settled_joints_from_servo(SERVO))).max()) > 1


def test_the_work_of_servo_and_springs_balances_without_friction():
    """An independent check of the guides with a radius: the servo's work is what drive, coupling
    and spring store.
    """
    digit = HPAC.digits["ring"]
    path = np.linspace(0.0, HPAC.servo_max[3], 60)
    metal = Metal(guide_radius=1e-3)
    q = follow([digit], [metal], path[:, None])[:, 0]
    chord = np.sqrt(
        digit.d1**2 + digit.d2**2 - 2 * digit.d1 * digit.d2 * np.cos(digit.alpha - q[:, 0])
    )
    stretch = digit.servo_radius * path - (digit.rest_chord - chord - metal.guide_radius * q[:, 0])
    radius = np.array(digit.joint_radius)
    coupling = (
        0.5 * digit.segment_stiffness * (radius[:-1] * q[:, :-1] - radius[1:] * q[:, 1:]) ** 2
    )
    stored = (
        0.5 * digit.drive_stiffness * stretch**2
        + coupling.sum(axis=1)
        + 0.5 * digit.spring_stiffness * (q @ radius) ** 2
    )
    work = np.concatenate(
        [
            [0],
            np.cumsum(
                np.diff(path)
                * digit.servo_radius
                * digit.drive_stiffness
                * (stretch[1:] + stretch[:-1])
                / 2
            ),
        ]
    )
    assert work[-1] == pytest.approx(stored[-1], rel=1e-3)
    assert stored[-1] > 0.005


def test_a_stop_holds_its_joint_and_a_dead_band_stops_the_horn_short(nominal):
    dip = JOINT_INDEX["index_dip"]
    mcp = JOINT_INDEX["index_mcp"]
    stopped = hand_course(
        [Built(HPAC, (Metal(), *[Metal(stop=(9.0, 9.0, 0.8))] * 4))], SERVO, servos=SWEPT
    )[0]
    assert stopped[:, dip].max() == 0.8
    assert stopped[-1, mcp] < nominal[-1, mcp]
    short = course(servo=SERVO + 2e-3, dead_band=2e-3)
    assert short[1:, :-1] == pytest.approx(nominal[1:, :-1], abs=1e-4)


def test_every_digit_is_its_own_whatever_stands_beside_it():
    built = [
        Built(hand, (Metal(),) * 5) for hand in (HPAC, scaled_hand(HPAC, {"servo_radius": 1.02}))
    ]
    both = hand_course(built, SERVO, servos=SWEPT)
    assert both[1] == pytest.approx(hand_course(built[1:], SERVO, servos=SWEPT)[0], abs=CLOSE)
    assert np.abs(both[1] - both[0]).max() > 0.01
    index, fingers = (
        swept(hand_course(built, SERVO[:6], servos=servos))[..., 2:] for servos in ((1,), (1, 2, 4))
    )
    np.testing.assert_array_equal(
        fingers, index, "fingers that are computed together are to the bit as alone"
    )


def test_a_digit_that_does_not_come_to_rest_is_an_error_with_what_it_still_moves(monkeypatch):
    monkeypatch.setattr(quasistatic, "_ROUNDS", 2)
    with pytest.raises(
        SettleError, match=r"joints still move by \d\.\de-\d\d rad in round 2, .* below 2e-07 rad"
    ):
        course()
