"""Command maps: nominal to the bit, calibrated by the inverse of the whole file."""

from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    SERVOS,
    elastic_joints_from_servo,
    servo_from_action,
    synergy_from_action,
)
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.maps import POINTS, CommandMap
from hpac_gym.model.settled import (
    EXTENSION,
    FLEXION,
    settled_joints_from_servo,
    settled_servo_from_synergy,
)

ZEROS = (-0.08, 0.03, -0.05, 0.02, -0.1, 0.04)
CALIBRATED = replace(
    HPAC, name="measured", calibration=Calibration(ZEROS, (Friction(1e-3, 0.03),) * 5)
)
ROOTS = [JOINT_INDEX[name] for name in SERVOS]
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (50, 6))
FLEXING = np.random.default_rng(1).random((50, 6)) < 0.5


def test_a_nominal_model_commands_and_predicts_to_the_bit_as_the_paper_s_map():
    maps = CommandMap(HPAC, 50)
    servo = maps.servo_from_action(ACTIONS, FLEXING)
    predicted = maps.joints_from_servo(servo, FLEXING)
    np.testing.assert_array_equal(servo, servo_from_action(ACTIONS, HPAC))
    np.testing.assert_array_equal(predicted, elastic_joints_from_servo(servo, HPAC))
    assert maps.shown_servo(servo, predicted) is servo
    assert not maps.inverts_files


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_calibrated_hand_comes_to_rest_at_the_synergy_that_the_action_asks_for(way):
    """In both directions of friction, wherever the board's servo range does not clip it."""
    maps = CommandMap(CALIBRATED, 50)
    servo = maps.servo_from_action(ACTIONS, np.full((50, 6), way > 0))
    inside = (servo > HPAC.servo_min) & (servo < HPAC.servo_max)
    assert inside.mean() > 0.7
    reached = settled_joints_from_servo(servo, CALIBRATED, way)[:, ROOTS]
    wanted = synergy_from_action(ACTIONS)
    held = wanted > 0.25  # below, friction alone holds the joint at its stop
    assert np.abs(reached - wanted)[inside & held].max() < 1e-4
    nominal = settled_joints_from_servo(servo_from_action(ACTIONS), CALIBRATED, way)[:, ROOTS]
    assert np.abs(nominal - wanted)[inside & held].max() > 0.05  # the nominal map does not


def test_a_command_never_leaves_the_range_that_the_board_was_flashed_with():
    every = np.stack([-np.ones(6), np.ones(6)])
    for way in (True, False):
        servo = CommandMap(CALIBRATED, 2).servo_from_action(every, np.full((2, 6), way))
        assert (servo >= HPAC.servo_min).all()
        assert (servo <= HPAC.servo_max).all()


@pytest.mark.parametrize("way", [FLEXION, EXTENSION])
def test_the_tables_are_as_close_to_the_exact_map_as_they_say(way):
    """Also where the board's range clips a servo; a finger leaves its stop in the first cell."""
    synergy = np.random.default_rng(2).uniform(HPAC.synergy_min, HPAC.synergy_max, (4000, 6))
    exact = settled_servo_from_synergy(synergy, CALIBRATED, way)
    exact = np.clip(exact, HPAC.servo_min, HPAC.servo_max)
    told = CommandMap(CALIBRATED, 4000).servo_from_synergy(synergy, np.full((4000, 6), way > 0))
    first = synergy < HPAC.synergy_max / (POINTS - 1)
    assert np.abs(told - exact)[~first].max() < 3e-5
    assert np.abs(told - exact)[first].max() < 3e-3


def test_a_policy_sees_the_servos_of_the_nominal_hand_at_the_predicted_synergy():
    maps = CommandMap(CALIBRATED, 50)
    servo = maps.servo_from_action(ACTIONS, FLEXING)
    shown = maps.shown_servo(servo, maps.joints_from_servo(servo, FLEXING))
    inside = (servo > HPAC.servo_min + 1e-3) & (servo < HPAC.servo_max - 1e-3)
    inside &= synergy_from_action(ACTIONS) > 0.25
    assert np.abs(shown - servo_from_action(ACTIONS))[inside].max() < 1e-3
    assert np.abs(servo - servo_from_action(ACTIONS))[inside].max() > 0.05


def test_each_place_has_a_model_of_its_own():
    maps = CommandMap(HPAC, 3)
    other = replace(CALIBRATED, calibration=Calibration((0.0,) * 6, (Friction(2e-3, 0.0),) * 5))
    maps.take([0, 1, 2], [CALIBRATED, other, CALIBRATED])
    same = np.tile(ACTIONS[0], (3, 1))
    servo = maps.servo_from_action(same, np.ones((3, 6), dtype=bool))
    np.testing.assert_array_equal(servo[0], servo[2])
    assert np.abs(servo[0] - servo[1]).max() > 0.01
    alone = CommandMap(CALIBRATED).servo_from_action(same[:1], np.ones((1, 6), dtype=bool))
    np.testing.assert_array_equal(servo[0], alone[0])
