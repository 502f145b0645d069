"""The hand in PyBullet: six servos, tendons and springs move fifteen joints. No joint has a motor."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.model import DIGITS, FINGERS, HPAC, JOINTS, SERVOS, Hand, ServoCommand, joints_from_synergy, servo_from_synergy
from hpac_gym.model.checks import Array, as_finite_array
from hpac_gym.sim.assets import asset_path
from hpac_gym.sim.quiet import quiet_output
from hpac_gym.sim.servos import Servos, ServoSettings
from hpac_gym.sim.tendons import Damping, Tendons
from hpac_gym.sim.world import World

_PLACE = {"mcp": 0, "mp": 0, "cmc": 0, "pip": 1, "ip": 1, "dip": 2}
"""Of a joint in its digit, by what kind of joint it is."""
MAX_JOINT_SPEED = 20.0
"""Of a digit that snaps free of another one; a faster one would be far beyond its stop before the next step [rad/s]."""
_OTHER, _FINGER = 1, 64
"""Collision groups; 1 is Bullet's default, and 64 the first that it has no meaning for."""
_LOAD_FLAGS = (
    pybullet.URDF_USE_INERTIA_FROM_FILE
    | pybullet.URDF_USE_SELF_COLLISION
    | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
)


@dataclass(frozen=True, slots=True)
class HandSettings:
    """What the simulated hand has beyond the model's parameters.

    The armatures stand for the inertia of hubs and gears. They change no static force, and keep the stiffest tendon's
    ω dt below 1.5 at the physics rate that ships: without them explicit tendon torques diverge.
    """

    servo: ServoSettings = field(default_factory=ServoSettings)
    damping: Damping = field(default_factory=Damping)
    slack: tuple[float, ...] = (0.0,) * 5
    """What each driving tendon has to wind up before it pulls, by digit [m]."""
    joint_friction: float = 0.0
    """Coulomb friction of every joint [N·m]."""
    tendon_friction: float = 0.0
    """Share of the tendons' load that every joint's guides hold back, on top of `joint_friction`."""
    armature: tuple[float, float, float] = (3.2e-3, 1.2e-3, 3.6e-4)
    """Inertia added about each MCP, MP and CMC, about each PIP and IP, and about each DIP [kg·m²]."""
    contact_friction: float = 0.9
    """Coulomb coefficient of the hand's skin; PyBullet multiplies it with the object's."""


class SimHand:
    """One hand in a `World`.

    Args:
        world: where it lives.
        hand: the model's parameters.
        settings: what the simulation adds.
        urdf: `hpac_hand.urdf`, or `hpac_hand_on_wrist.urdf` to have the palm hang on three slides.
        position: of the wrist in the world, shape (3,) [m].
        orientation: of the hand's frame in the world, quaternion xyzw, shape (4,).
        visuals: load what only a camera sees.
    """

    def __init__(
        self,
        world: World,
        hand: Hand = HPAC,
        settings: HandSettings = HandSettings(),
        urdf: str = "hpac_hand.urdf",
        position: ArrayLike = (0.0, 0.0, 0.0),
        orientation: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        visuals: bool = True,
    ) -> None:
        self.world, self._client = world, world.client
        self.body = pybullet.loadURDF(
            str(asset_path(urdf)), list(position), list(orientation), useFixedBase=True,
            flags=_LOAD_FLAGS if visuals else _LOAD_FLAGS | pybullet.URDF_IGNORE_VISUAL_SHAPES,
            physicsClientId=self._client,
        )  # fmt: skip
        info = [pybullet.getJointInfo(self.body, i, self._client) for i in range(pybullet.getNumJoints(self.body, self._client))]
        self.link_index = {entry[12].decode(): entry[0] for entry in info}
        self.joint_index = {entry[1].decode(): entry[0] for entry in info}
        self.part_of_link = {
            index: next((digit for digit in DIGITS if name.startswith(digit)), "palm") for name, index in self.link_index.items()
        }
        self._joints = [self.joint_index[name] for name in JOINTS]
        self._add_armature(settings.armature)
        self.collide(True)
        self.configure(hand, settings)

    def configure(self, hand: Hand, settings: HandSettings) -> None:
        """Become another hand: everything but the armature, which a hand is loaded with, can change.

        Raises:
            ValueError: The settings have another armature.
        """
        if settings.armature != self.armature:
            raise ValueError(f"armature {settings.armature} kg m² is not {self.armature} kg m², which this hand was loaded with")
        self.hand, self.settings = hand, settings
        for name, index in self.joint_index.items():
            friction = settings.joint_friction if name in JOINTS else 0.0
            pybullet.setJointMotorControl2(
                self.body, index, pybullet.VELOCITY_CONTROL, targetVelocity=0, force=friction, physicsClientId=self._client
            )
        for index in range(-1, len(self.joint_index)):
            pybullet.changeDynamics(
                self.body, index, linearDamping=0, angularDamping=0, jointDamping=0,
                lateralFriction=settings.contact_friction, physicsClientId=self._client,
            )  # fmt: skip
        # A call of its own: with the limit in it, PyBullet leaves out a link's friction in silence.
        pybullet.changeDynamics(self.body, -1, maxJointVelocity=MAX_JOINT_SPEED, physicsClientId=self._client)
        self.servos = Servos(settings.servo)
        self.tendons = Tendons(hand, self.inertia(), self.world.settings.dt, settings.damping, settings.slack)
        self.tension = [0.0] * (len(SERVOS) - 1)

    def _add_armature(self, armatures: tuple[float, float, float]) -> None:
        self.armature = armatures
        for name, index in zip(JOINTS, self._joints, strict=True):
            armature = armatures[_PLACE[name.split("_")[1]]]
            inertia = np.array(pybullet.getDynamicsInfo(self.body, index, self._client)[2])
            pybullet.changeDynamics(
                self.body, index, localInertiaDiagonal=(inertia + armature).tolist(), physicsClientId=self._client
            )

    def collide(self, solid: bool) -> None:
        """Let the hand touch things, or pass through everything. Fingers never reach each other and are not checked for it."""
        for name, index in self.link_index.items():
            group = _FINGER if name.split("_")[0] in FINGERS else _OTHER
            mask = ~_FINGER if group == _FINGER else -1
            pybullet.setCollisionFilterGroupMask(self.body, index, group * solid, mask * solid, self._client)

    def inertia(self) -> Array:
        """Joint-space inertia of the fifteen joints at half stroke, armature included, shape (15, 15) [kg·m²]."""
        posture = np.zeros(len(self.joint_index))
        posture[self._joints] = joints_from_synergy(self.hand.synergy_max / 2, self.hand)
        with quiet_output():  # it prints that a unit axis is not one, at the last bit
            matrix = np.array(pybullet.calculateMassMatrix(self.body, posture.tolist(), physicsClientId=self._client))
        return matrix[np.ix_(self._joints, self._joints)]

    # State ---------------------------------------------------------------------

    def reset(self, synergy: ArrayLike) -> None:
        """Put the hand on its manifold and at rest, the servos where they hold it there.

        Args:
            synergy: shape (6,) [rad].
        """
        synergy = as_finite_array(synergy, len(SERVOS), "synergy")
        for index, angle in zip(self._joints, joints_from_synergy(synergy, self.hand), strict=True):
            pybullet.resetJointState(self.body, index, angle, 0.0, physicsClientId=self._client)
        self.servos.reset(servo_from_synergy(synergy, self.hand))
        self.tension = [0.0] * (len(SERVOS) - 1)

    def joint_state(self) -> tuple[Array, Array]:
        """True joint angles and speeds, shapes (15,) [rad] and (15,) [rad/s]. The real hand cannot measure them."""
        position, velocity = self._joint_state()
        return np.array(position), np.array(velocity)

    def _joint_state(self) -> tuple[list[float], list[float]]:
        states = pybullet.getJointStates(self.body, self._joints, self._client)
        return [state[0] for state in states], [state[1] for state in states]

    @property
    def joint_pos(self) -> Array:
        """True joint angles, shape (15,) [rad]."""
        return self.joint_state()[0]

    # Motion --------------------------------------------------------------------

    def command(self, command: ServoCommand) -> None:
        """Start a synchronised move of the six servos."""
        self.servos.command(command)

    def apply_tendons(self) -> None:
        """Advance the servos by one physics step and put the tendons' torques on the joints, for the step to come."""
        self.servos.advance(self.world.settings.dt)
        joint_pos, joint_vel = self._joint_state()
        torque, self.tension = self.tendons.torque(joint_pos, joint_vel, self.servos.horn, self.servos.velocity)
        if self.settings.tendon_friction:
            friction = self.settings.joint_friction + self.settings.tendon_friction * self.tendons.load(joint_pos, self.tension)
            pybullet.setJointMotorControlArray(
                self.body, self._joints, pybullet.VELOCITY_CONTROL, targetVelocities=[0.0] * len(self._joints),
                forces=friction.tolist(), physicsClientId=self._client,
            )  # fmt: skip
        pybullet.setJointMotorControlArray(
            self.body, self._joints, pybullet.TORQUE_CONTROL, forces=torque, physicsClientId=self._client
        )

    def step(self, seconds: float) -> None:
        """Advance hand and world by whole physics steps, as many as fit `seconds`."""
        for _ in range(round(seconds / self.world.settings.dt)):
            self.apply_tendons()
            self.world.step()
