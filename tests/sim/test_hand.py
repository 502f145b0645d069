"""The hand in PyBullet against the paper and against statics, at the settings that ship."""

import dataclasses

import numpy as np
import pybullet
import pytest

from hpac_gym.model import (
    FINGERS,
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVO_INDEX,
    SERVOS,
    ServoCommand,
    joints_from_synergy,
    servo_from_synergy,
)
from hpac_gym.sim import HandSettings, ObjectSpec, ServoSettings, SimHand, SimObject, World, WorldSettings, Wrist
from hpac_gym.sim.scene import HAND_POSITION, HAND_QUATERNION, HAND_ROTATION

ROOTS = [JOINT_INDEX[name] for name in SERVOS]


@pytest.fixture
def weightless():
    with World(WorldSettings(gravity=0.0)) as world:
        yield world


def without_collisions(hand: SimHand) -> SimHand:
    """The same hand, digits passing through each other, so that any synergy is free space."""
    for link in range(-1, len(hand.joint_index)):
        pybullet.setCollisionFilterGroupMask(hand.body, link, 0, 0, hand.world.client)
    return hand


def move(hand: SimHand, synergy: np.ndarray, seconds: float = 4.0) -> np.ndarray:
    hand.command(ServoCommand(servo_from_synergy(synergy), 0.4))
    hand.step(seconds)
    return hand.joint_pos


def test_free_space_is_equations_12_and_13_and_mcp_follows_its_servo(weightless):
    """PIP, DIP and IP within 1e-3 rad of the elastic map of the simulated MCP and MP; MCP and MP within 0.3° of the command."""
    hand = without_collisions(SimHand(weightless))
    rng = np.random.default_rng(0)
    for _ in range(25):
        synergy = HPAC.synergy_max * rng.uniform(0.03, 0.97, 6)
        joints = move(hand, synergy)
        assert np.abs(joints - joints_from_synergy(joints[ROOTS])).max() < 1e-3
        assert np.degrees(np.abs(joints[ROOTS] - synergy)).max() < 0.3


def test_the_hand_opens_by_its_springs(weightless):
    hand = without_collisions(SimHand(weightless))
    hand.reset(HPAC.synergy_max * 0.9)
    assert np.degrees(move(hand, np.zeros(6), 3.0)).max() < 0.5


def test_no_joint_has_a_motor(weightless):
    """A pushed finger yields: with its drive slack only a spring holds it."""
    hand = without_collisions(SimHand(weightless))
    hand.reset(np.zeros(6))
    link = hand.link_index["index_dip_link"]
    for _ in range(240):
        pybullet.applyExternalForce(hand.body, link, (0.3, 0, 0), (0, 0, 0.02), pybullet.LINK_FRAME, hand.world.client)
        hand.step(hand.world.settings.dt)
    bent = hand.joint_pos
    assert bent[JOINT_INDEX["index_mcp"]] > 0.1
    assert np.abs(bent[JOINT_INDEX["middle_mcp"]]) < 1e-3


@pytest.mark.parametrize("finger", FINGERS)
def test_a_blocked_fingertip_carries_the_torque_of_the_tendon(weightless, finger):
    """Contact torque Jᵀf equals the tendons' torque on MCP, PIP and DIP within 1 %."""
    hand = SimHand(weightless)
    synergy = np.zeros(6)
    synergy[SERVO_INDEX[f"{finger}_mcp"]] = 0.6
    hand.reset(synergy)
    weightless.step()
    joints = [f"{finger}_{suffix}" for suffix in ("mcp", "pip", "dip")]
    tip = hand.joint_index[joints[-1]]
    place_peg(hand, tip)
    synergy[SERVO_INDEX[f"{finger}_mcp"]] = 0.9
    move(hand, synergy)

    state = hand.joint_state()
    tendon = hand.tendons.torque(*state, hand.servos.horn, hand.servos.velocity)[0]
    contact = contact_torque(hand, joints)
    wanted = np.array([tendon[JOINT_INDEX[name]] for name in joints])
    assert wanted.min() > 0.01, "the fingertip is not loaded"
    np.testing.assert_allclose(-contact, wanted, rtol=0.01)


def place_peg(hand: SimHand, tip: int) -> None:
    """Put a fixed, frictionless ball just in front of the fingertip's pad."""
    position, rotation = link_frame(hand, tip)
    radius, ball = hand_tip_radius(hand, tip), 0.004
    centre = position + rotation @ np.array([radius + ball + 3e-4, 0.0, 0.012])
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=ball, physicsClientId=hand.world.client)
    peg = pybullet.createMultiBody(0, shape, basePosition=centre.tolist(), physicsClientId=hand.world.client)
    pybullet.changeDynamics(peg, -1, lateralFriction=0.0, physicsClientId=hand.world.client)


def hand_tip_radius(hand: SimHand, link: int) -> float:
    return pybullet.getCollisionShapeData(hand.body, link, hand.world.client)[0][3][1]


def link_frame(hand: SimHand, link: int) -> tuple[np.ndarray, np.ndarray]:
    state = pybullet.getLinkState(hand.body, link, computeForwardKinematics=1, physicsClientId=hand.world.client)
    return np.array(state[4]), np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))


def contact_torque(hand: SimHand, joints: list[str]) -> np.ndarray:
    """Torque about each joint's +y axis of all contact forces on its link and the links beyond it."""
    torque = np.zeros(len(joints))
    for contact in pybullet.getContactPoints(bodyA=hand.body, physicsClientId=hand.world.client):
        force = contact[9] * np.array(contact[7])
        for i, name in enumerate(joints):
            if hand.joint_index[joints[0]] <= hand.joint_index[name] <= contact[3]:
                position, rotation = link_frame(hand, hand.joint_index[name])
                torque[i] += rotation[:, 1] @ np.cross(np.array(contact[5]) - position, force)
    return torque


def test_a_held_cylinder_creeps_less_than_2_mm_in_10_s():
    """0.15 kg, 50 mm wide, held from the side in a closed grasp."""
    with World() as world:
        hand = SimHand(world, urdf="hpac_hand_on_wrist.urdf", position=HAND_POSITION, orientation=HAND_QUATERNION)
        Wrist(hand, HAND_ROTATION)
        synergy = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2])
        hand.reset(synergy)
        spec = ObjectSpec("cylinder", (0.025, 0.025, 0.06), mass=0.15, friction=0.8)
        item = SimObject(world, spec, HAND_POSITION + HAND_ROTATION @ np.array([0.042, 0.0, 0.11]))
        pybullet.changeDynamics(item.body, -1, mass=0.0, physicsClientId=world.client)
        move(hand, np.array([0.9, *HPAC.synergy_max[1:5], 1.2]), 1.5)
        pybullet.changeDynamics(item.body, -1, mass=spec.mass, physicsClientId=world.client)
        hand.step(0.5)
        start, _ = item.pose()
        hand.step(10.0)
        end, _ = item.pose()
        assert np.linalg.norm(start - HAND_POSITION) < 0.2, "the object was not held at all"
        assert np.linalg.norm(end - start) < 2e-3


def test_the_stiffest_tendon_is_resolved_by_the_physics_step(weightless):
    """ω dt stays below 1.5 for the whole workspace: explicit torques need it."""
    hand = SimHand(weightless)
    inertia, dt = hand._mass_matrix(), weightless.settings.dt
    roots = [JOINT_INDEX[digit.joints[0]] for digit in HPAC.digits.values()]
    for share in np.linspace(0, 1, 11):
        stiffness = -hand.tendons._linear[:, : len(JOINTS)]
        arm, _ = hand.tendons._arm_and_chord(share * HPAC.synergy_max[:5])
        stiffness[roots, roots] += hand.tendons._stiffness * arm**2
        stiffness[JOINT_INDEX["thumb_cmc"], JOINT_INDEX["thumb_cmc"]] += HPAC.cmc_stiffness
        fastest = np.sqrt(np.linalg.eigvals(np.linalg.solve(inertia, stiffness)).real.max())
        assert fastest * dt < 1.5


def test_joint_friction_holds_a_finger_that_is_let_go(weightless):
    """10 mN·m of Coulomb friction in each joint stops it where the spring pulls less: 0.01/(k_s R ΣR q/q) = 0.3 rad."""
    hand = without_collisions(SimHand(weightless, settings=HandSettings(joint_friction=0.01)))
    hand.reset(HPAC.synergy_max * 0.5)
    left = np.degrees(move(hand, np.zeros(6), 3.0)[JOINT_INDEX["index_mcp"]])
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
