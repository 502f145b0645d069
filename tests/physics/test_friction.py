"""A ball squeezed between two leaning plates, or turned between two parallel ones: which engine and
solver holds it.

The ball stays while the tangent of the lean is below the friction coefficient, however small its
mass. Bullet's direct solver (Dantzig) computes the limit of every friction force from the normal
forces that there would be without any friction. In a squeeze these are too small, so that it loses
the ball at half of the cone.

A torque about the line through both contacts turns the ball unless the contacts have torsional
friction, as MuJoCo's here have and as Bullet's iterative solver can have. These two differences are
why PyBullet loses round objects that MuJoCo holds: docs/physics.md, "Why PyBullet loses round
objects"."""

import re
from functools import partial

import mujoco
import numpy as np
import pytest

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.physics.mjcf import SOFTNESS, TORSION, hand_mjcf
from hpac_gym.physics.settings import HandSettings, WorldSettings

FRICTION = 0.5
PUSH = 5.0
MASS = 0.06
RADIUS = 0.025
STEPS = 120
HELD = 0.05
"""Farthest place of a ball that the plates hold after a second [m]."""
STILL = 0.1
"""Fastest spin of a ball that they keep from turning [rad/s]."""
HELD_TORQUE = 2 * TORSION * PUSH
"""Torque that two contacts with torsional friction hold [N·m]."""


def mujoco_ball(lean: float, torque: float = 0.0, torsion: float = TORSION) -> tuple[float, float]:
    """How far the ball moves [m], and how fast it turns at the end [rad/s], in MuJoCo with the
    engine's contact settings.
    """
    plates = ""
    actuators = ""
    for side in (-1, 1):
        x = side * np.cos(lean)
        z = np.sin(lean)  # from the ball to the plate
        place = f"{x * (RADIUS + 0.005)} 0 {z * (RADIUS + 0.005)}"
        plates += (
            f'<body pos="{place}" euler="0 {-side * lean} 0"><joint name="plate{side}" type="slide" axis="1 0 0"/>'
            f'<geom type="box" size="0.005 0.05 0.05" mass="1"/></body>'
        )
        actuators += f'<motor joint="plate{side}" gear="{-side * PUSH}"/>'
    (options,) = re.findall("<option .*", hand_mjcf(HPAC_GEOMETRY, HandSettings()))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/>{options}'
        f'<default><geom condim="4" friction="{FRICTION} {torsion} 0.0001" {SOFTNESS}/></default>'
        f'<worldbody><body name="ball"><freejoint/><geom type="sphere" size="{RADIUS}" mass="{MASS}"/></body>{plates}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )
    model.opt.gravity[:] = 0.0
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    data.body("ball").xfrc_applied[3] = torque
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    return float(np.linalg.norm(data.body("ball").xpos)), float(np.linalg.norm(data.qvel[3:6]))


def bullet_ball(
    lean: float, iterations: int, torque: float = 0.0, torsion: float = 0.0
) -> tuple[float, float]:
    """How far the ball moves [m], and how fast it turns at the end [rad/s], in PyBullet with the
    engine's settings of the direct solver, or of the iterative one.
    """
    import pybullet

    from hpac_gym.physics.pybullet.world import World

    world = World(WorldSettings(gravity=0.0, solver_iterations=iterations))
    client = world.client
    ball_shape = pybullet.createCollisionShape(
        pybullet.GEOM_SPHERE, radius=RADIUS, physicsClientId=client
    )
    plate_shape = pybullet.createCollisionShape(
        pybullet.GEOM_BOX, halfExtents=[0.005, 0.05, 0.05], physicsClientId=client
    )
    ball = pybullet.createMultiBody(
        MASS, ball_shape, basePosition=[0, 0, 0], physicsClientId=client
    )
    pybullet.changeDynamics(
        ball,
        -1,
        lateralFriction=FRICTION,
        spinningFriction=torsion,
        linearDamping=0,
        angularDamping=0,
        physicsClientId=client,
    )
    plates = []
    for side in (-1, 1):
        x = side * np.cos(lean)
        z = np.sin(lean)
        plate = pybullet.createMultiBody(
            0,
            linkMasses=[1.0],
            linkCollisionShapeIndices=[plate_shape],
            linkVisualShapeIndices=[-1],
            linkPositions=[[x * (RADIUS + 0.005), 0, z * (RADIUS + 0.005)]],
            linkOrientations=[pybullet.getQuaternionFromEuler([0, -side * lean, 0])],
            linkInertialFramePositions=[[0, 0, 0]],
            linkInertialFrameOrientations=[[0, 0, 0, 1]],
            linkParentIndices=[0],
            linkJointTypes=[pybullet.JOINT_PRISMATIC],
            linkJointAxis=[[1, 0, 0]],
            physicsClientId=client,
        )
        pybullet.setJointMotorControl2(
            plate, 0, pybullet.VELOCITY_CONTROL, force=0, physicsClientId=client
        )
        pybullet.changeDynamics(
            plate, 0, lateralFriction=1.0, linearDamping=0, jointDamping=0, physicsClientId=client
        )
        plates.append((plate, -side * PUSH))
    for _ in range(STEPS):
        for plate, push in plates:
            pybullet.setJointMotorControl2(
                plate, 0, pybullet.TORQUE_CONTROL, force=push, physicsClientId=client
            )
        pybullet.applyExternalTorque(
            ball, -1, [torque, 0, 0], pybullet.WORLD_FRAME, physicsClientId=client
        )
        pybullet.stepSimulation(physicsClientId=client)
    position, _ = pybullet.getBasePositionAndOrientation(ball, physicsClientId=client)
    _, spin = pybullet.getBaseVelocity(ball, physicsClientId=client)
    world.close()
    return float(np.linalg.norm(position)), float(np.linalg.norm(spin))


TWIST = pytest.mark.parametrize("share", [0.02, 0.6, 0.9, 1.1, 1.5])


@pytest.mark.parametrize("share", [0.2, 0.6, 0.8, 1.2, 1.6])
@pytest.mark.parametrize(
    ("ball", "limit"),
    [
        (mujoco_ball, 1.0),
        pytest.param(
            partial(bullet_ball, iterations=200), 1.0, marks=pytest.mark.pybullet, id="iterative"
        ),
        pytest.param(
            partial(bullet_ball, iterations=0), 0.5, marks=pytest.mark.pybullet, id="direct"
        ),
    ],
)
def test_a_ball_is_held_within_the_friction_cone_but_by_bullets_direct_solver_within_half_of_it(
    ball, limit, share
):
    moved, _ = ball(np.arctan(share * FRICTION))
    assert (moved < HELD) == (share < limit)


@TWIST
def test_mujoco_holds_a_ball_against_a_torque_by_torsional_friction_alone(share):
    torque = share * HELD_TORQUE
    assert (mujoco_ball(0.0, torque)[1] < STILL) == (share < 1.0)
    assert mujoco_ball(0.0, torque, torsion=0.0)[1] > STILL


@pytest.mark.pybullet
@TWIST
def test_bullet_has_torsional_friction_in_its_iterative_solver_alone_and_only_on_request(share):
    torque = share * HELD_TORQUE
    assert (bullet_ball(0.0, 200, torque, TORSION)[1] < STILL) == (share < 1.0)
    assert bullet_ball(0.0, 200, torque)[1] > STILL
    assert bullet_ball(0.0, 0, torque, TORSION)[1] > STILL
