"""Access of the gate's tests to PyBullet and to the internals of an environment.

The other tests of the gate use only actions, observations, rewards and infos.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import gymnasium
import numpy as np
import pybullet

from hpac_gym.model import DIGITS, JOINTS
from hpac_gym.physics.pybullet.hand import SimHand
from tests.envs.stories import State


def sim_hand(env: gymnasium.Env) -> SimHand:
    """The simulated hand of an environment that has been reset."""
    return env.unwrapped.episodes.simulation.engine.scenes[0].hand


class Bodies:
    """The bodies of an environment's world: the hand has joints, the object has a mass, everything
    else is fixed.
    """

    def __init__(self, env: gymnasium.Env) -> None:
        self.client = sim_hand(env).world.client
        bodies = sorted(
            pybullet.getBodyUniqueId(index, self.client)
            for index in range(pybullet.getNumBodies(self.client))
        )
        self.hand, *others = sorted(
            bodies, key=lambda body: -pybullet.getNumJoints(body, self.client)
        )
        free = [body for body in others if pybullet.getDynamicsInfo(body, -1, self.client)[0] > 0]
        self.object = free[0] if free else None
        self.fixed = [body for body in others if body not in free]

    def touching(self) -> bool:
        """Whether the hand touches the object or itself."""
        others = [self.hand] if self.object is None else [self.hand, self.object]
        found = (
            pybullet.getContactPoints(self.hand, other, physicsClientId=self.client)
            for other in others
        )
        return any(contact[8] <= 0 for contacts in found for contact in contacts)

    def simple(self) -> bool:
        """Whether the object is one sphere or one box, or there is none."""
        if self.object is None:
            return True
        shapes = pybullet.getCollisionShapeData(self.object, -1, physicsClientId=self.client)
        return len(shapes) == 1 and shapes[0][2] in (pybullet.GEOM_SPHERE, pybullet.GEOM_BOX)

    def pin(self) -> None:
        """Fix the object where it is; it has no mass from then on."""
        if self.object is not None:
            pybullet.changeDynamics(self.object, -1, mass=0, physicsClientId=self.client)


@contextmanager
def watching_for_touch(bodies: Bodies) -> Iterator[Callable[[], bool]]:
    """Whether the hand has touched the object or itself in any physics step since the block
    began.
    """
    step = pybullet.stepSimulation
    seen = []

    def watched(*arguments: Any, **named: Any) -> None:
        step(*arguments, **named)
        seen.append(bodies.touching())

    with patch.object(pybullet, "stepSimulation", watched):
        yield lambda: any(seen)


def flick(env: gymnasium.Env, joint: str, speed: float) -> None:
    """Give one joint a speed [rad/s]."""
    hand = sim_hand(env)
    client = sim_hand(env).world.client
    index = hand.joint_index[joint]
    angle = pybullet.getJointState(hand.body, index, physicsClientId=client)[0]
    pybullet.resetJointState(hand.body, index, angle, speed, physicsClientId=client)


@contextmanager
def told(env: gymnasium.Env, story: Callable[[float], State]) -> Iterator[None]:
    """Replace the engine's results by a story. The wrist follows its motors' targets without delay.

    Args:
        env: environment that has been reset.
        story: function of the time since the reset [s] that gives the state.
    """
    bodies = Bodies(env)
    client = bodies.client
    dt = pybullet.getPhysicsEngineParameters(client)["fixedTimeStep"]
    info = [
        pybullet.getJointInfo(bodies.hand, index, client)
        for index in range(pybullet.getNumJoints(bodies.hand, client))
    ]
    joint_of = {row[0]: JOINTS.index(row[1].decode()) for row in info if row[1].decode() in JOINTS}
    slides = {row[0]: 0.0 for row in info if row[2] == pybullet.JOINT_PRISMATIC}
    link_of = {
        part: next(row[0] for row in info if row[12].decode().startswith(part))
        for part in ("palm", *DIGITS)
    }
    hand_turn = pybullet.getBasePositionAndOrientation(bodies.hand, client)[1]
    rotation = np.reshape(pybullet.getMatrixFromQuaternion(hand_turn), (3, 3))
    start, turn = pybullet.getBasePositionAndOrientation(bodies.object, client)
    motors = pybullet.setJointMotorControlArray
    steps = 0
    now = story(0.0)
    way = np.zeros(3)
    wrist = np.zeros(3)

    def step(*_: Any, **__: Any) -> None:
        nonlocal steps, now, way, wrist
        steps = steps + 1
        now = story(steps * dt)
        before = wrist
        wrist = rotation @ list(slides.values())
        way = way + (wrist - before) * now.carried

    def control(body: int, joints: list[int], mode: int, **named: Any) -> None:
        if mode == pybullet.POSITION_CONTROL:
            slides.update(zip(joints, named["targetPositions"], strict=True))
        motors(body, joints, mode, **named)

    def joint_states(body: int, joints: list[int], *_: Any, **__: Any) -> list[tuple[float, float]]:
        return [
            (slides[joint], 0.0)
            if joint in slides
            else (float(now.joint_pos[joint_of[joint]]), float(now.joint_vel[joint_of[joint]]))
            for joint in joints
        ]

    def pose(body: int, *_: Any, **__: Any) -> tuple[list[float], tuple[float, ...]]:
        half = now.tilt / 2
        _, orientation = pybullet.multiplyTransforms(
            (0, 0, 0), (np.sin(half), 0, 0, np.cos(half)), (0, 0, 0), turn
        )
        return (start + now.slipped + way).tolist(), orientation

    def velocity(body: int, *_: Any, **__: Any) -> tuple[list[float], list[float]]:
        return now.velocity.tolist(), now.spin.tolist()

    def contacts(item: int, *_: Any, **__: Any) -> list[tuple]:
        centre = start + now.slipped + way
        rows = []
        for place, (part, force) in enumerate(now.forces.items()):
            outward = np.array([np.cos(2.4 * place), np.sin(2.4 * place), 0.2 * place - 0.3])
            outward /= np.linalg.norm(outward)
            point = centre + 0.02 * outward
            rows.append(
                (0, item, bodies.hand, -1, link_of[part], point, point, -outward, 0.0, force)
            )
        for met, support in ((now.supported, bodies.fixed[0]), (now.placed, bodies.fixed[-1])):
            if met:
                rows.append((0, item, support, -1, -1, start, start, (0, 0, 1), 0.0, 1.0))
        return rows

    with patch.multiple(
        pybullet,
        stepSimulation=step,
        setJointMotorControlArray=control,
        getJointStates=joint_states,
        getBasePositionAndOrientation=pose,
        getBaseVelocity=velocity,
        getContactPoints=contacts,
    ):
        yield
