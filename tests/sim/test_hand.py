"""The hand in PyBullet against the paper and against statics, at the settings that ship."""

import dataclasses

import numpy as np
import pybullet
import pytest

from hpac_gym.model import FINGERS, HPAC, JOINT_INDEX, ServoCommand
from hpac_gym.sim import HandSettings, ServoSettings, SimHand, World, WorldSettings, check


@pytest.fixture
def weightless():
    with World(check.WEIGHTLESS) as world:
        yield world


def test_free_space_is_equations_12_and_13_and_mcp_follows_its_servo():
    """PIP, DIP and IP within 1e-3 rad of the elastic map of the simulated MCP and MP; MCP and MP within 0.3° of the command."""
    manifold, command = check.free_space()
    assert manifold < 1e-3
    assert command < 0.3


@pytest.mark.parametrize("finger", FINGERS)
def test_a_blocked_fingertip_carries_the_torque_of_the_tendon(finger):
    """Contact torque Jᵀf equals the tendons' torque on MCP, PIP and DIP within 1 %."""
    assert check.blocked_fingertip(finger) < 0.01


def test_a_held_cylinder_creeps_less_than_2_mm_in_10_s():
    """0.15 kg, 50 mm wide, held from the side in a closed grasp."""
    assert check.held_cylinder_creep() < 2e-3


def test_the_stiffest_tendon_is_resolved_by_the_physics_step():
    """ω dt stays below 1.5 for the whole workspace: explicit torques need it."""
    assert 0.5 < check.stiffest_mode() < 1.5


def test_a_slack_finger_hangs_between_its_weight_and_its_spring():
    """Palm down, servos at rest: without pretension it droops, and the spring keeps it from falling far."""
    assert 0.05 < check.slack_droop() < 0.3


@pytest.mark.parametrize("finger", ["index", "middle", "ring"])
def test_the_thumb_opposes(finger):
    """Within 2 mm, at the opposition postures of the geometry."""
    assert check.opposition_gap(finger) < 2e-3


def test_the_hand_opens_by_its_springs(weightless):
    hand = check.pass_through(SimHand(weightless))
    hand.reset(HPAC.synergy_max * 0.9)
    assert np.degrees(check.settle(hand, np.zeros(6), 3.0)).max() < 0.5


def test_no_joint_has_a_motor(weightless):
    """A pushed finger yields: with its drive slack only a spring holds it."""
    hand = check.pass_through(SimHand(weightless))
    hand.reset(np.zeros(6))
    link = hand.link_index["index_dip_link"]
    for _ in range(240):
        pybullet.applyExternalForce(hand.body, link, (0.3, 0, 0), (0, 0, 0.02), pybullet.LINK_FRAME, hand.world.client)
        hand.step(hand.world.settings.dt)
    bent = hand.joint_pos
    assert bent[JOINT_INDEX["index_mcp"]] > 0.1
    assert np.abs(bent[JOINT_INDEX["middle_mcp"]]) < 1e-3


def test_joint_friction_holds_a_finger_that_is_let_go(weightless):
    """10 mN·m of Coulomb friction in each joint stops it where the spring pulls less: 0.01/(k_s R ΣR q/q) = 0.3 rad."""
    hand = check.pass_through(SimHand(weightless, settings=HandSettings(joint_friction=0.01)))
    hand.reset(HPAC.synergy_max * 0.5)
    left = np.degrees(check.settle(hand, np.zeros(6), 3.0)[JOINT_INDEX["index_mcp"]])
    assert 5.0 < left < 17.0


def test_servos_arrive_together_and_on_time(weightless):
    hand = SimHand(weightless)
    target = HPAC.servo_max * [0.2, 0.4, 0.6, 0.8, 1.0, 0.5]
    hand.command(ServoCommand(target, 0.5))
    hand.step(0.25)
    np.testing.assert_allclose(hand.servos.horn, target / 2, atol=hand.settings.servo.dead_band + 0.01)
    hand.step(0.25)
    np.testing.assert_allclose(hand.servos.horn, target, atol=hand.settings.servo.dead_band)


def test_a_servo_is_no_faster_than_its_data_sheet(weightless):
    hand = SimHand(weightless, settings=HandSettings(servo=ServoSettings(speed=2.0)))
    hand.command(ServoCommand(HPAC.servo_max, 0.01))
    hand.step(0.25)
    np.testing.assert_allclose(hand.servos.horn, 0.5, atol=1e-9)


def test_a_servo_leaves_its_dead_band_alone(weightless):
    hand = SimHand(weightless)
    hand.command(ServoCommand(np.full(6, 0.9 * hand.settings.servo.dead_band), 0.1))
    hand.step(0.5)
    np.testing.assert_array_equal(hand.servos.horn, 0.0)


@pytest.mark.parametrize(
    ("settings", "change"),
    [(ServoSettings, {"speed": 0.0}), (ServoSettings, {"dead_band": -1.0}), (WorldSettings, {"physics_hz": 0})],
)
def test_settings_name_the_bad_value(settings, change):
    with pytest.raises(ValueError, match=str(next(iter(change.values())))):
        dataclasses.replace(settings(), **change)


def test_every_link_has_the_skin_s_friction(weightless):
    hand = SimHand(weightless, settings=HandSettings(contact_friction=0.37))
    for link in hand.link_index.values():
        assert pybullet.getDynamicsInfo(hand.body, link, weightless.client)[1] == 0.37
