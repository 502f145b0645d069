"""The hand in PyBullet: six servos move fifteen joints through tendons and springs. No joint has a
motor.
"""

import warnings
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.body.geometry import Geometry
from hpac_gym.body.urdf import WRIST_EFFORT, hand_urdf
from hpac_gym.model import DIGITS, FINGERS, JOINTS, Hand, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, PARTS, PhysicsWarning
from hpac_gym.physics.mechanics import armature_of
from hpac_gym.physics.pybullet.world import World, quiet_output
from hpac_gym.physics.settings import HandSettings
from hpac_gym.physics.tendons import Tendons

_SLIDES = ("wrist_x", "wrist_y", "wrist_z")
_OTHER = 1
_FINGER = 64
"""Collision groups: 1 is Bullet's default, 64 the first without a predefined meaning."""
FASTEST = 1.4
"""Largest ω dt of a single tendon at which explicit torques are stable: 1.2 in the nominal hand."""
MAX_JOINT_SPEED = 20.0
"""Joint speed limit: that of a digit that snaps free of another one [rad/s]."""
_UNDAMPED = {"linearDamping": 0, "angularDamping": 0, "jointDamping": 0}
_urdf = lru_cache(maxsize=64)(hand_urdf)
_LOAD_FLAGS = (
    pybullet.URDF_USE_INERTIA_FROM_FILE
    | pybullet.URDF_USE_SELF_COLLISION
    | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
)


class SimHand:
    """One hand in a `World`, at `HAND_POSITION`.

    Args:
        world: PyBullet world into which it is loaded.
        hand: the model's parameters.
        settings: settings of the simulated hand.
        geometry: geometry of the hand.
        on_wrist: mount the palm on three slides.
        orientation: quaternion xyzw of the hand's frame in the world, shape (4,).
    """

    def __init__(
        self,
        world: World,
        hand: Hand,
        settings: HandSettings,
        geometry: Geometry,
        on_wrist: bool,
        orientation: ArrayLike,
    ) -> None:
        self.world = world
        self._client = world.client
        flags = _LOAD_FLAGS if world.visuals else _LOAD_FLAGS | pybullet.URDF_IGNORE_VISUAL_SHAPES
        with TemporaryDirectory() as folder:  # PyBullet loads from files only
            file = Path(folder, "hand.urdf")
            file.write_text(_urdf(geometry, on_wrist), encoding="utf-8")
            self.body = pybullet.loadURDF(
                str(file),
                list(HAND_POSITION),
                list(orientation),
                useFixedBase=True,
                flags=flags,
                physicsClientId=world.client,
            )
        info = [
            pybullet.getJointInfo(self.body, index, self._client)
            for index in range(pybullet.getNumJoints(self.body, self._client))
        ]
        self.joint_index = {entry[1].decode(): entry[0] for entry in info}
        self.link_index = {entry[12].decode(): entry[0] for entry in info}
        for name in JOINTS:
            link = self.joint_index[name]
            inertia = np.array(pybullet.getDynamicsInfo(self.body, link, self._client)[2])
            inertia += armature_of(name, settings.armature)
            self._change(link, localInertiaDiagonal=inertia.tolist())
        self.part_of_link = {-1: 0} | {
            index: next((part for part, digit in enumerate(PARTS) if name.startswith(digit)), 0)
            for name, index in self.link_index.items()
        }
        self._joints = [self.joint_index[name] for name in JOINTS]
        self._slides = [self.joint_index[name] for name in _SLIDES if name in self.joint_index]
        self._moving = self._joints + self._slides
        self._rotation = np.reshape(pybullet.getMatrixFromQuaternion(orientation), (3, 3))
        self._axes = self._rotation.T.tolist()
        self.collide(True)
        self.configure(hand, settings)

    def configure(self, hand: Hand, settings: HandSettings) -> None:
        """Switch to another hand. The armature, which is set on loading, stays the same."""
        self.hand = hand
        self.settings = settings
        friction = [settings.joint_friction] * len(self._joints)
        self._brake(self._moving, friction + [0.0] * len(self._slides))
        for index in range(-1, len(self.joint_index)):
            self._change(index, **_UNDAMPED, lateralFriction=settings.contact_friction)
        for joint, lower, upper in zip(self._joints, hand.joint_min, hand.joint_max, strict=True):
            self._change(joint, jointLowerLimit=lower, jointUpperLimit=upper)
        # PyBullet silently ignores lateralFriction if maxJointVelocity is passed with it.
        self._change(-1, maxJointVelocity=MAX_JOINT_SPEED)
        half_stroke = np.zeros(len(self._moving))
        half_stroke[self._joints] = joints_from_synergy(hand.synergy_max / 2, hand)
        with quiet_output():  # it warns about unit axes that are off in the last bit
            inertia = np.array(
                pybullet.calculateMassMatrix(
                    self.body, half_stroke.tolist(), physicsClientId=self._client
                )
            )
        self.tendons = Tendons(
            hand,
            inertia[np.ix_(self._joints, self._joints)],
            self.world.settings.dt,
            settings.damping,
            settings.slack,
            settings.strength,
        )
        if (fastest := self.tendons.fastest) > FASTEST:
            warnings.warn(
                f"ω dt of the hand's stiffest tendon is {fastest:.2f}: above {FASTEST} joints shiver in PyBullet, not in MuJoCo",
                PhysicsWarning,
                stacklevel=2,
            )

    def _change(self, link: int, **dynamics: Any) -> None:
        pybullet.changeDynamics(self.body, link, **dynamics, physicsClientId=self._client)

    def collide(self, solid: bool) -> None:
        """Enable or disable collisions of the hand. Fingers cannot reach each other, so pairs of
        fingers are never checked.
        """
        solid = solid and self.world.settings.collisions
        for name, index in self.link_index.items():
            finger = name.split("_")[0] in FINGERS
            (group, mask) = (_FINGER, ~_FINGER) if finger else (_OTHER, -1)
            pybullet.setCollisionFilterGroupMask(
                self.body, index, group * solid, mask * solid, self._client
            )

    def reset(self, synergy: ArrayLike) -> None:
        """Reset the hand to rest on its manifold, and the wrist to its start.

        Args:
            synergy: shape (6,) [rad].
        """
        angles = [*joints_from_synergy(synergy, self.hand), *[0.0] * len(self._slides)]
        pybullet.resetJointStatesMultiDof(
            self.body,
            self._moving,
            [[angle] for angle in angles],
            [[0.0]] * len(angles),
            physicsClientId=self._client,
        )
        self.tension = [0.0] * len(DIGITS)
        self._wrist: list[float] | None = None
        self.move_wrist([0.0, 0.0, 0.0])

    def state(self) -> tuple[tuple[float, ...], tuple[float, ...], Array]:
        """True joint angles [rad] and speeds [rad/s], 15 of each, and the offset of the palm from
        its start, along the world's axes, shape (3,) [m]. The real hand measures none of them.
        """
        positions, speeds, *_ = zip(
            *pybullet.getJointStates(self.body, self._moving, self._client), strict=True
        )
        count = len(self._joints)
        offset = self._rotation.dot(positions[count:]) if self._slides else np.zeros(3)
        return positions[:count], speeds[:count], offset

    def move_wrist(self, offset: list[float]) -> None:
        """Set the palm's target for the end of the next step, reached unless a force above
        `WRIST_EFFORT` resists.

        Args:
            offset: offset from the start, along the world's axes, 3 values [m].
        """
        if not self._slides or offset == self._wrist:  # the motors keep their last target
            return
        self._wrist = offset
        x, y, z = offset
        pybullet.setJointMotorControlArray(
            self.body,
            self._slides,
            pybullet.POSITION_CONTROL,
            targetPositions=[a * x + b * y + c * z for a, b, c in self._axes],
            targetVelocities=[0.0] * 3,
            forces=[self.world.settings.wrist_effort or WRIST_EFFORT] * 3,
            positionGains=[1.0] * 3,
            velocityGains=[1.0] * 3,
            physicsClientId=self._client,
        )

    def apply_tendons(self, servo: list[float], servo_vel: list[float]) -> None:
        """Apply the tendons' torques to the joints for the next step.

        Args:
            servo: angles of the horns, 6 values [rad].
            servo_vel: their speeds, 6 values [rad/s].
        """
        joint_pos, joint_vel, *_ = zip(
            *pybullet.getJointStates(self.body, self._joints, self._client), strict=True
        )
        torque, self.tension = self.tendons.torque(joint_pos, joint_vel, servo, servo_vel)
        if self.settings.tendon_friction:
            friction = (
                self.settings.joint_friction
                + self.settings.tendon_friction * self.tendons.load(joint_pos, self.tension)
            )
            self._brake(self._joints, friction.tolist())
        pybullet.setJointMotorControlArray(
            self.body,
            self._joints,
            pybullet.TORQUE_CONTROL,
            forces=torque,
            physicsClientId=self._client,
        )

    def _brake(self, joints: list[int], friction: list[float]) -> None:
        """Set the Coulomb friction of joints [N·m] and slides [N]."""
        pybullet.setJointMotorControlArray(
            self.body,
            joints,
            pybullet.VELOCITY_CONTROL,
            targetVelocities=[0.0] * len(joints),
            forces=friction,
            physicsClientId=self._client,
        )
