"""The hand in PyBullet: six servos move fifteen joints through tendons and springs. No joint has a
motor.
"""

from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.body.geometry import Geometry
from hpac_gym.body.urdf import WRIST_EFFORT, hand_urdf
from hpac_gym.model import DIGITS, FINGERS, JOINTS, Hand, joints_from_synergy
from hpac_gym.model.checks import Array, as_finite_array
from hpac_gym.physics.engine import HAND_POSITION
from hpac_gym.physics.mechanics import armature_of
from hpac_gym.physics.pybullet.world import World, quiet_output
from hpac_gym.physics.settings import HandSettings
from hpac_gym.physics.tendons import Tendons

_SLIDES = ("wrist_x", "wrist_y", "wrist_z")
_OTHER = 1
_FINGER = 64
"""Collision groups: 1 is Bullet's default, 64 the first without a predefined meaning."""
MAX_JOINT_SPEED = 20.0
"""Joint speed limit: that of a digit that snaps free of another one [rad/s]."""
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
        visuals: load visual shapes.
    """

    def __init__(
        self,
        world: World,
        hand: Hand,
        settings: HandSettings,
        geometry: Geometry,
        on_wrist: bool,
        orientation: ArrayLike,
        visuals: bool,
    ) -> None:
        self.world = world
        self._client = world.client
        flags = _LOAD_FLAGS if visuals else _LOAD_FLAGS | pybullet.URDF_IGNORE_VISUAL_SHAPES
        with TemporaryDirectory() as folder:  # PyBullet loads from files only
            file = Path(folder, "hand.urdf")
            file.write_text(_urdf(geometry, on_wrist), encoding="utf-8")
            self.body = pybullet.loadURDF(
                str(file),
                list(HAND_POSITION),
                list(orientation),
                useFixedBase=True,
                flags=flags,
                physicsClientId=self._client,
            )
        info = [
            pybullet.getJointInfo(self.body, i, self._client)
            for i in range(pybullet.getNumJoints(self.body, self._client))
        ]
        self.link_index = {entry[12].decode(): entry[0] for entry in info}
        self.joint_index = {entry[1].decode(): entry[0] for entry in info}
        self.part_of_link = {
            index: next((digit for digit in DIGITS if name.startswith(digit)), "palm")
            for name, index in self.link_index.items()
        } | {-1: "palm"}
        self._joints = [self.joint_index[name] for name in JOINTS]
        self._slides = [self.joint_index[name] for name in _SLIDES if name in self.joint_index]
        self._rotation = np.reshape(pybullet.getMatrixFromQuaternion(list(orientation)), (3, 3))
        self._axes = self._rotation.T.tolist()
        for name, index in zip(JOINTS, self._joints, strict=True):
            inertia = np.array(
                pybullet.getDynamicsInfo(self.body, index, self._client)[2]
            ) + armature_of(name, settings.armature)
            pybullet.changeDynamics(
                self.body,
                index,
                localInertiaDiagonal=inertia.tolist(),
                physicsClientId=self._client,
            )
        self.collide(True)
        self.configure(hand, settings)

    def configure(self, hand: Hand, settings: HandSettings) -> None:
        """Switch to another hand. The armature, which is set on loading, stays the same."""
        self.hand = hand
        self.settings = settings
        for name, index in self.joint_index.items():
            friction = settings.joint_friction if name in JOINTS else 0.0
            pybullet.setJointMotorControl2(
                self.body,
                index,
                pybullet.VELOCITY_CONTROL,
                targetVelocity=0,
                force=friction,
                physicsClientId=self._client,
            )
        for index in range(-1, len(self.joint_index)):
            pybullet.changeDynamics(
                self.body,
                index,
                linearDamping=0,
                angularDamping=0,
                jointDamping=0,
                lateralFriction=settings.contact_friction,
                physicsClientId=self._client,
            )
        # Separate call: PyBullet silently ignores lateralFriction if maxJointVelocity is passed
        # with it.
        pybullet.changeDynamics(
            self.body, -1, maxJointVelocity=MAX_JOINT_SPEED, physicsClientId=self._client
        )
        self.tendons = Tendons(
            hand,
            self.inertia(),
            self.world.settings.dt,
            settings.damping,
            settings.slack,
            settings.strength,
        )
        self.tension = [0.0] * len(DIGITS)

    def collide(self, solid: bool) -> None:
        """Enable or disable collisions of the hand. Fingers cannot reach each other, so pairs of
        fingers are never checked.
        """
        solid = solid and self.world.settings.collisions
        for name, index in self.link_index.items():
            group = _FINGER if name.split("_")[0] in FINGERS else _OTHER
            mask = ~_FINGER if group == _FINGER else -1
            pybullet.setCollisionFilterGroupMask(
                self.body, index, group * solid, mask * solid, self._client
            )

    def inertia(self) -> Array:
        """Joint-space inertia of the fifteen joints at half stroke, armature included, shape (15,
        15) [kg·m²].
        """
        posture = np.zeros(len(self.joint_index))
        posture[self._joints] = joints_from_synergy(self.hand.synergy_max / 2, self.hand)
        with quiet_output():  # it warns about unit axes that are off in the last bit
            matrix = np.array(
                pybullet.calculateMassMatrix(
                    self.body, posture.tolist(), physicsClientId=self._client
                )
            )
        return matrix[np.ix_(self._joints, self._joints)]

    # State ---------------------------------------------------------------------

    def reset(self, synergy: ArrayLike) -> None:
        """Reset the hand to rest on its manifold, and the wrist to its start.

        Args:
            synergy: shape (6,) [rad].
        """
        synergy = as_finite_array(synergy, 6, "synergy")
        for index, angle in zip(self._joints, joints_from_synergy(synergy, self.hand), strict=True):
            pybullet.resetJointState(self.body, index, angle, 0.0, physicsClientId=self._client)
        self.tension = [0.0] * len(DIGITS)
        self._wrist: list[float] | None = None
        for slide in self._slides:
            pybullet.resetJointState(self.body, slide, 0.0, 0.0, physicsClientId=self._client)
        self.move_wrist([0.0, 0.0, 0.0])

    def joint_state(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """True joint angles [rad] and speeds [rad/s], 15 of each. The real hand cannot measure
        them.
        """
        joint_pos, joint_vel, *_ = zip(
            *pybullet.getJointStates(self.body, self._joints, self._client), strict=True
        )
        return joint_pos, joint_vel

    @property
    def palm_offset(self) -> Array:
        """Offset of the palm from its start, along the world's axes, shape (3,) [m]."""
        if not self._slides:
            return np.zeros(3)
        states = pybullet.getJointStates(self.body, self._slides, self._client)
        return self._rotation @ [state[0] for state in states]

    # Motion --------------------------------------------------------------------

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
        joint_pos, joint_vel = self.joint_state()
        torque, self.tension = self.tendons.torque(joint_pos, joint_vel, servo, servo_vel)
        if self.settings.tendon_friction:
            friction = (
                self.settings.joint_friction
                + self.settings.tendon_friction * self.tendons.load(joint_pos, self.tension)
            )
            pybullet.setJointMotorControlArray(
                self.body,
                self._joints,
                pybullet.VELOCITY_CONTROL,
                targetVelocities=[0.0] * len(self._joints),
                forces=friction.tolist(),
                physicsClientId=self._client,
            )
        pybullet.setJointMotorControlArray(
            self.body,
            self._joints,
            pybullet.TORQUE_CONTROL,
            forces=torque,
            physicsClientId=self._client,
        )
