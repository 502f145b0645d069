"""The tendons and springs: joint torques from joint states and servo angles. Pure numpy, no simulator.

Per digit, root joint first:

* **drive**: a tendon from the servo's hub to the root joint: `hpac_gym.sim.drive`.
* **coupling**: a figure-eight loop between neighbouring joints, stretch ``R_i q_i − R_(i+1) q_(i+1)``, taut both ways. A
  finger's first segment has stiffness 2EA/L and all the others EA/L: with these the static equilibrium in free space *is*
  Eq. (12), because the restoring cable passes every joint and so the first segment carries twice the spring's tension. The
  thumb's one segment has EA/L, which is Eq. (13).
* **spring**: tension ``k_s Σ R q``, Eq. (10), acts on every joint with its radius. No pretension: a straight finger is held
  by nothing but its stop, and a finger with a slack drive hangs where its weight and its spring balance.

Tendons are Kelvin–Voigt elements: damping acts on the stretch's rate, so it vanishes in a tendon that follows its servo, and a
slack one has none. CMC is a stiff spring between servo 6 and the joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model import JOINT_INDEX, JOINTS, SERVO_INDEX, Hand
from hpac_gym.model.checks import Array
from hpac_gym.sim.drive import Drive

_CMC = SERVO_INDEX["thumb_cmc"]
_CMC_JOINT = JOINT_INDEX["thumb_cmc"]


def coupling_rows(hand: Hand) -> tuple[Array, Array]:
    """The coupling segments: how each one's stretch depends on the joints, and how stiff it is.

    Returns:
        Rows J with stretch = J q, shape (9, 15) [m/rad], and stiffnesses, shape (9,) [N/m].
    """
    rows, stiffnesses = [], []
    for digit in hand.digits.values():
        for segment, length in enumerate(digit.path_length):
            row = np.zeros(len(JOINTS))
            row[JOINT_INDEX[digit.joints[segment]]] = digit.joint_radius[segment]
            row[JOINT_INDEX[digit.joints[segment + 1]]] = -digit.joint_radius[segment + 1]
            doubled = 2.0 if segment == 0 and len(digit.path_length) > 1 else 1.0
            rows.append(row)
            stiffnesses.append(doubled * digit.tendon_stiffness / length)
    return np.array(rows), np.array(stiffnesses)


def spring_rows(hand: Hand) -> tuple[Array, Array]:
    """The restoring springs: excursion = J q, shape (5, 15) [m/rad], and stiffnesses, shape (5,) [N/m]. Eq. (10)."""
    rows = np.zeros((len(hand.digits), len(JOINTS)))
    for row, digit in zip(rows, hand.digits.values(), strict=True):
        row[[JOINT_INDEX[name] for name in digit.joints]] = digit.joint_radius
    return rows, np.array([digit.spring_stiffness for digit in hand.digits.values()])


@dataclass(frozen=True, slots=True)
class Damping:
    """How the tendons lose energy.

    Raises:
        ValueError: A negative value.
    """

    ratio: float = 0.3
    """Damping ratio of each tendon with the inertia that it moves."""
    joint: float = 5e-3
    """Viscous friction of every joint [N·m·s/rad]."""
    overrun: float = 1.0
    """Share of its damping that a slack drive keeps against flexion faster than its servo's. The hand's armature stands for
    servos, which stop where they are told: without this a finger would fly on with an inertia that is not its own."""

    def __post_init__(self) -> None:
        if not (self.ratio >= 0 and self.joint >= 0 and self.overrun >= 0):
            raise ValueError(
                f"damping ratio {self.ratio}, joint damping {self.joint} N m s/rad, overrun {self.overrun}: none may be negative"
            )


class Tendons:
    """Torques of all tendons and springs of one hand.

    Damping coefficients are those of an implicit step: a coefficient c on an element that moves the mass m becomes
    c / (1 + c dt/m), which stays stable at any c. What happens six times a physics step is plain floats, since an array of six
    costs more to make than to calculate; what is linear in all joints is one product of a matrix.

    Args:
        hand: the parameters.
        mass_matrix: joint-space inertia at a typical posture, shape (15, 15) [kg·m²]; only damping depends on it.
        dt: physics step [s].
        damping: how the tendons lose energy.
        slack: what each drive has to wind up before it pulls, shape (5,) or () [m].

    Attributes:
        drives: the five driving tendons, by digit.
    """

    def __init__(self, hand: Hand, mass_matrix: Array, dt: float, damping: Damping, slack: ArrayLike = 0.0) -> None:
        self.hand = hand
        compliance = np.linalg.inv(mass_matrix)

        def viscosity(stiffness: Array, mobility: Array) -> Array:
            explicit = 2 * damping.ratio * np.sqrt(stiffness / mobility)
            return explicit / (1 + explicit * dt * mobility)

        rows, stiffness = coupling_rows(hand)
        mobility = np.einsum("ij,jk,ik->i", rows, compliance, rows)
        springs, spring_stiffness = spring_rows(hand)
        stiffness_matrix = rows.T @ (stiffness[:, None] * rows) + springs.T @ (spring_stiffness[:, None] * springs)
        viscosity_matrix = rows.T @ (viscosity(stiffness, mobility)[:, None] * rows) + damping.joint * np.eye(len(JOINTS))
        self._linear = -np.hstack([stiffness_matrix, viscosity_matrix])
        self._coupling, self._levers = stiffness[:, None] * rows, np.abs(rows).T
        self._spring_torque = springs.T @ (spring_stiffness[:, None] * springs)
        self._state = np.empty(2 * len(JOINTS))

        def damped(drive: Drive, flexed: float) -> Drive:
            _, arm = drive.chord_and_arm(flexed)
            mobility = arm**2 * compliance[drive.joint, drive.joint]
            coefficient = float(viscosity(np.float64(drive.stiffness), mobility))
            return replace(drive, viscosity=coefficient, brake=damping.overrun * coefficient)

        slacks = np.broadcast_to(slack, len(hand.digits)).tolist()
        undamped = map(Drive.of, hand.digits.values(), slacks)
        self.drives = tuple(map(damped, undamped, hand.synergy_max[:_CMC].tolist()))
        cmc = viscosity(np.array(hand.cmc_stiffness), compliance[_CMC_JOINT, _CMC_JOINT])
        self._cmc_viscosity = float(cmc)

    def stiffness_matrix(self, synergy: Array) -> Array:
        """How the joint torques answer to the joint angles where all drives are taut, shape (15, 15) [N·m/rad].

        Args:
            synergy: angles of the driven joints, shape (6,) [rad]; the drives' moment arms depend on them.
        """
        matrix = -self._linear[:, : len(JOINTS)]
        for drive, angle in zip(self.drives, synergy[:_CMC].tolist(), strict=True):
            matrix[drive.joint, drive.joint] += drive.stiffness * drive.chord_and_arm(angle)[1] ** 2
        matrix[_CMC_JOINT, _CMC_JOINT] += self.hand.cmc_stiffness
        return matrix

    def load(self, joint_pos: ArrayLike, tension: Sequence[float]) -> Array:
        """What the tendons and the spring press every joint's guides with: their torques, added without their signs.

        Args:
            joint_pos: q, shape (15,) [rad].
            tension: of the drives, shape (5,) [N].

        Returns:
            Shape (15,) [N·m].
        """
        joint_pos = np.asarray(joint_pos)
        load = self._levers @ np.abs(self._coupling @ joint_pos) + self._spring_torque @ joint_pos
        for drive, pull in zip(self.drives, tension, strict=True):
            load[drive.joint] += pull * drive.chord_and_arm(joint_pos[drive.joint])[1]
        return np.maximum(load, 0.0)

    def torque(
        self, joint_pos: Sequence[float], joint_vel: Sequence[float], servo: Sequence[float], servo_vel: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Torque of all elements on every joint, and the tension of the drives.

        Args:
            joint_pos: q, shape (15,) [rad].
            joint_vel: shape (15,) [rad/s].
            servo: where the servos' horns are, shape (6,) [rad].
            servo_vel: shape (6,) [rad/s].

        Returns:
            Torque, by joint [N·m], positive in flexion, and tension, by digit [N].
        """
        hand, state, joints = self.hand, self._state, len(JOINTS)
        state[:joints], state[joints:] = joint_pos, joint_vel
        torque: list[float] = (self._linear @ state).tolist()
        tensions = []
        for i, drive in enumerate(self.drives):
            joint = drive.joint
            tension, arm = drive.tension(joint_pos[joint], joint_vel[joint], servo[i], servo_vel[i])
            torque[joint] += tension * arm
            tensions.append(tension)
        twist = hand.cmc_gain * servo[_CMC] - joint_pos[_CMC_JOINT]
        rate = hand.cmc_gain * servo_vel[_CMC] - joint_vel[_CMC_JOINT]
        pull = hand.cmc_stiffness * twist + self._cmc_viscosity * rate
        torque[_CMC_JOINT] += min(max(pull, -hand.cmc_torque_limit), hand.cmc_torque_limit)
        return torque, tensions

