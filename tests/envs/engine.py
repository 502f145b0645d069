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

from hpac_gym.model import DIGITS
from hpac_gym.physics.pybullet.scene import DISTANCE, Scene
from tests.envs.stories import Story


def scene_of(env: gymnasium.Env) -> Scene:
    """The PyBullet world of an environment that has been reset."""
    return env.unwrapped.episodes.simulation.engine.scenes[0]


def touching(scene: Scene) -> bool:
    """Whether the hand touches the object or itself."""
    others = [scene.hand.body, *([scene.object.body] if scene.object else [])]
    found = (
        pybullet.getContactPoints(scene.hand.body, other, physicsClientId=scene.world.client)
        for other in others
    )
    return any(contact[DISTANCE] <= 0 for contacts in found for contact in contacts)


def simple(env: gymnasium.Env) -> bool:
    """Whether the object is one sphere or one box, or there is none."""
    scene = scene_of(env)
    if scene.object is None:
        return True
    client = scene.world.client
    shapes = pybullet.getCollisionShapeData(scene.object.body, -1, physicsClientId=client)
    return len(shapes) == 1 and shapes[0][2] in (pybullet.GEOM_SPHERE, pybullet.GEOM_BOX)


def pin(env: gymnasium.Env) -> None:
    """Fix the object where it is; it has no mass from then on."""
    scene = scene_of(env)
    if scene.object:
        pybullet.changeDynamics(scene.object.body, -1, mass=0, physicsClientId=scene.world.client)


@contextmanager
def watching_for_touch(env: gymnasium.Env) -> Iterator[Callable[[], bool]]:
    """Whether the hand has touched the object or itself in any physics step since the block
    began.
    """
    step = pybullet.stepSimulation
    seen = []

    def watched(*arguments: Any, **named: Any) -> None:
        step(*arguments, **named)
        seen.append(touching(scene_of(env)))

    with patch.object(pybullet, "stepSimulation", watched):
        yield lambda: any(seen)


def flick(env: gymnasium.Env, joint: str, speed: float) -> None:
    """Give one joint a speed [rad/s]."""
    scene = scene_of(env)
    body = scene.hand.body
    index = scene.hand.joint_index[joint]
    client = scene.world.client
    angle = pybullet.getJointState(body, index, physicsClientId=client)[0]
    pybullet.resetJointState(body, index, angle, speed, physicsClientId=client)


@contextmanager
def told(env: gymnasium.Env, story: Story) -> Iterator[None]:
    """Replace the engine's results by a story. The wrist follows its motors' targets without delay.

    Args:
        env: environment that has been reset.
        story: gives the state by the time since the reset [s].
    """
    scene = scene_of(env)
    hand = scene.hand
    client = scene.world.client
    dt = scene.world.settings.dt
    slides = dict.fromkeys(hand._slides, 0.0)
    joint_of = {index: joint for joint, index in enumerate(hand._joints)}
    links = hand.link_index.items()
    link_of = {
        part: next(link for name, link in links if name.startswith(part))
        for part in ("palm", *DIGITS)
    }
    count = pybullet.getNumBodies(client)
    bodies = {pybullet.getBodyUniqueId(index, client) for index in range(count)}
    fixed = sorted(bodies - {hand.body, scene.object.body})
    start, turn = pybullet.getBasePositionAndOrientation(scene.object.body, client)
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
        wrist = hand._rotation @ list(slides.values())
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
            rows.append((0, item, hand.body, -1, link_of[part], point, point, -outward, 0.0, force))
        for met, support in ((now.supported, fixed[0]), (now.placed, fixed[-1])):
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
