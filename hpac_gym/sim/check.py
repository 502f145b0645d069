"""Measures the simulated hand against the paper and against statics: ``python -m hpac_gym.sim.check``.

The figures of docs/physics.md come from here, and the tests hold the same functions to the same marks.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, dataclass

import numpy as np
import pybullet

from hpac_gym.model import (
    FINGERS,
    HPAC,
    JOINT_INDEX,
    SERVO_INDEX,
    SERVOS,
    ServoCommand,
    joints_from_synergy,
    servo_from_synergy,
)
from hpac_gym.model.checks import Array
from hpac_gym.sim.geometry import load_geometry
from hpac_gym.sim.hand import SimHand
from hpac_gym.sim.objects import ObjectSpec, SimObject
from hpac_gym.sim.scene import HAND_POSITION, HAND_QUATERNION, HAND_ROTATION
from hpac_gym.sim.world import World, WorldSettings
from hpac_gym.sim.wrist import Wrist

_ROOTS = [JOINT_INDEX[name] for name in SERVOS]
WEIGHTLESS = WorldSettings(gravity=0.0)


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured figure and its mark: it holds if the value is at most the limit."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def holds(self) -> bool:
        return self.value <= self.limit


def free_space(postures: int = 25, seed: int = 0) -> tuple[float, float]:
    """Without gravity, and digits passing through each other so that all of the workspace is free space.

    Returns:
        Largest distance of PIP, DIP and IP from Eqs. (12), (13) of the simulated MCP and MP [rad], and largest distance of
        MCP, MP and CMC from what was commanded [°], over random synergies.
    """
    rng = np.random.default_rng(seed)
    manifold = command = 0.0
    with World(WEIGHTLESS) as world:
        hand = pass_through(SimHand(world))
        for _ in range(postures):
            synergy = HPAC.synergy_max * rng.uniform(0.03, 0.97, len(SERVOS))
            joints = settle(hand, synergy)
            manifold = max(manifold, float(np.abs(joints - joints_from_synergy(joints[_ROOTS])).max()))
            command = max(command, float(np.degrees(np.abs(joints[_ROOTS] - synergy).max())))
    return manifold, command


def blocked_fingertip(finger: str) -> float:
    """How far the contact torque Jᵀf of a blocked fingertip is from the tendons' torque, of MCP, PIP and DIP, relative."""
    with World(WEIGHTLESS) as world:
        hand = SimHand(world)
        synergy = np.zeros(len(SERVOS))
        synergy[SERVO_INDEX[f"{finger}_mcp"]] = 0.6
        hand.reset(synergy)
        world.step()
        joints = [f"{finger}_{suffix}" for suffix in ("mcp", "pip", "dip")]
        _place_peg(hand, hand.joint_index[joints[-1]])
        synergy[SERVO_INDEX[f"{finger}_mcp"]] = 0.9
        settle(hand, synergy)
        torque, _ = hand.tendons.torque(*hand.joint_state(), hand.servos.horn, hand.servos.velocity)
        tendon = np.array([torque[JOINT_INDEX[name]] for name in joints])
        return float(np.abs(_contact_torque(hand, joints) / tendon + 1).max())


def held_cylinder_creep(seconds: float = 10.0) -> float:
    """How far a 0.15 kg cylinder, 50 mm wide, moves in a closed grasp from the side [m]; infinite if it is not held."""
    with World() as world:
        hand = SimHand(world, urdf="hpac_hand_on_wrist.urdf", position=HAND_POSITION, orientation=HAND_QUATERNION)
        Wrist(hand, HAND_ROTATION)
        hand.reset(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2]))
        spec = ObjectSpec("cylinder", (0.025, 0.025, 0.06), mass=0.15, friction=0.8)
        item = SimObject(world, spec, HAND_POSITION + HAND_ROTATION @ np.array([0.042, 0.0, 0.105]))
        pybullet.changeDynamics(item.body, -1, mass=0.0, physicsClientId=world.client)
        settle(hand, np.array([0.9, *HPAC.synergy_max[1:5], 1.2]), 1.5)
        pybullet.changeDynamics(item.body, -1, mass=spec.mass, physicsClientId=world.client)
        hand.step(0.5)
        start, _ = item.pose()
        hand.step(seconds)
        end, _ = item.pose()
        held = np.linalg.norm(start - HAND_POSITION) < 0.2
        return float(np.linalg.norm(end - start)) if held else np.inf


def stiffest_mode() -> float:
    """Largest ω dt of the hand's tendons over the workspace; explicit torques need it well below 2."""
    with World(WEIGHTLESS) as world:
        hand = SimHand(world)
        inertia = hand.inertia()
        modes = [
            np.linalg.eigvals(np.linalg.solve(inertia, hand.tendons.stiffness_matrix(share * HPAC.synergy_max))).real.max()
            for share in np.linspace(0.0, 1.0, 11)
        ]
        return float(np.sqrt(max(modes)) * world.settings.dt)


def slack_droop() -> float:
    """How far the most drooping finger's MCP hangs with the palm down and all servos at rest [rad]."""
    palm_down = (0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5))
    with World() as world:
        hand = SimHand(world, orientation=palm_down)
        hand.reset(np.zeros(len(SERVOS)))
        hand.step(4.0)
        return float(max(hand.joint_pos[JOINT_INDEX[f"{finger}_mcp"]] for finger in FINGERS))


def opposition_gap(finger: str) -> float:
    """Distance between the thumb's last link and a finger's, at the posture that opposes them [m]."""
    with World(WEIGHTLESS) as world:
        hand = SimHand(world)
        hand.reset(np.array(load_geometry().opposition[finger]))
        links = hand.link_index["thumb_ip_link"], hand.link_index[f"{finger}_dip_link"]
        points = pybullet.getClosestPoints(hand.body, hand.body, 0.1, *links, physicsClientId=world.client)
        return abs(min(point[8] for point in points))


def pass_through(hand: SimHand) -> SimHand:
    """Let the hand's links pass through everything; returns the hand."""
    hand.collide(False)
    return hand


def settle(hand: SimHand, synergy: Array, seconds: float = 8.0) -> Array:
    """Command a synergy, wait, and read the joints: shape (15,) [rad]."""
    hand.command(ServoCommand(servo_from_synergy(synergy), 0.4))
    hand.step(seconds)
    return hand.joint_pos


def figures() -> list[Figure]:
    """All figures, with the marks that the hand is held to."""
    manifold, command = free_space()
    blocked = max(blocked_fingertip(finger) for finger in FINGERS)
    gap = max(opposition_gap(finger) for finger in ("index", "middle", "ring"))
    return [
        Figure("free space: PIP, DIP, IP against Eqs. (12), (13)", manifold, 1e-3, "rad"),
        Figure("free space: MCP, MP, CMC against the command", command, 0.3, "deg"),
        Figure("blocked fingertip: contact torque against tendon torque", 100 * blocked, 1.0, "%"),
        Figure("held cylinder, 0.15 kg: creep in 10 s", 1e3 * held_cylinder_creep(), 2.0, "mm"),
        Figure("opposition: thumb to index, middle and ring", 1e3 * gap, 2.0, "mm"),
        Figure("palm down, servos at rest: most drooping MCP", slack_droop(), 0.3, "rad"),
        Figure("stiffest tendon: omega dt", stiffest_mode(), 1.5, "1"),
    ]


def _place_peg(hand: SimHand, tip: int) -> None:
    """Put a fixed, frictionless ball just in front of a fingertip's palmar side."""
    position, rotation = _link_frame(hand, tip)
    radius = pybullet.getCollisionShapeData(hand.body, tip, hand.world.client)[0][3][1]
    ball = 0.004
    centre = position + rotation @ np.array([radius + ball + 3e-4, 0.0, 0.012])
    shape = pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=ball, physicsClientId=hand.world.client)
    peg = pybullet.createMultiBody(0, shape, basePosition=centre.tolist(), physicsClientId=hand.world.client)
    pybullet.changeDynamics(peg, -1, lateralFriction=0.0, physicsClientId=hand.world.client)


def _contact_torque(hand: SimHand, joints: list[str]) -> Array:
    """Torque about each joint's +y axis of all contact forces on its link and the links beyond it, shape (n,) [N·m]."""
    torque = np.zeros(len(joints))
    for contact in pybullet.getContactPoints(bodyA=hand.body, physicsClientId=hand.world.client):
        force = contact[9] * np.array(contact[7])
        for i, name in enumerate(joints):
            if hand.joint_index[joints[0]] <= hand.joint_index[name] <= contact[3]:
                position, rotation = _link_frame(hand, hand.joint_index[name])
                torque[i] += rotation[:, 1] @ np.cross(np.array(contact[5]) - position, force)
    return torque


def _link_frame(hand: SimHand, link: int) -> tuple[Array, Array]:
    state = pybullet.getLinkState(hand.body, link, computeForwardKinematics=1, physicsClientId=hand.world.client)
    return np.array(state[4]), np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m hpac_gym.sim.check", description=__doc__.splitlines()[0])
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    measured = figures()
    if arguments.json:
        print(json.dumps([{**asdict(figure), "holds": figure.holds} for figure in measured], indent=2))
    else:
        for figure in measured:
            missed = "" if figure.holds else "  MISSED"
            print(f"{figure.name:<58} {figure.value:9.2g} {figure.unit:<4} mark {figure.limit:g}{missed}")
    return 0 if all(figure.holds for figure in measured) else 1


if __name__ == "__main__":
    raise SystemExit(main())
