"""Tendon and spring torques from joint states and servo angles, in NumPy, without a simulator.

Per digit, root joint first:

* **drive**: a tendon from the servo's hub to the root joint: `Drive`.
* **coupling**: a figure-eight loop between neighbouring joints, stretch ``R_i q_i − R_(i+1)
  q_(i+1)``, taut both ways. A finger's first segment has stiffness 2EA/L and all the others EA/L:
  with these the static equilibrium in free space *is* Eq. (12), because the restoring cable passes
  every joint and so the first segment carries twice the spring's tension. The thumb's one segment
  has EA/L, which is Eq. (13).
* **spring**: tension ``k_s Σ R q``, Eq. (10), acts on every joint with its radius. No pretension: a
  straight finger is held only by its stop, and a finger with a slack drive hangs where its weight
  and its spring balance.

Tendons are Kelvin–Voigt elements: damping acts on the stretch's rate, so it vanishes in a tendon
that follows its servo, and a slack one has none. CMC is a stiff spring between servo 6 and the
joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import cos, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model import JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.guides import chord_from_included
from hpac_gym.physics.settings import Damping

_CMC = SERVO_INDEX["thumb_cmc"]
_CMC_JOINT = JOINT_INDEX["thumb_cmc"]
ROOTS = [JOINT_INDEX[joint] for joint in SERVOS[:-1]]
"""Joints that the five drives pull."""
COUPLINGS = 9
"""Number of coupling segments."""
RIGID = 5e5
"""Largest stiffness of a drive that is simulated (chosen) [N/m]. Hand files of a sweep may have any
above it for a tendon whose stretch is not seen; it would be too fast for the time step.
"""


def element_rows(hand: Hand) -> tuple[Array, Array]:
    """The elements whose length is linear in the joint angles: nine coupling segments, whose length
    is their stretch, then five restoring springs, whose length is their excursion, Eq. (10).

    Returns:
        Rows J with length = J q, shape (14, 15) [m/rad], and stiffnesses, shape (14,) [N/m].
    """
    digits = list(hand.digits.values())
    segments = [(digit, index) for digit in digits for index in range(len(digit.joints) - 1)]
    rows = np.zeros((COUPLINGS + len(digits), len(JOINTS)))
    for row, (digit, index) in zip(rows, segments, strict=False):
        row[JOINT_INDEX[digit.joints[index]]] = digit.joint_radius[index]
        row[JOINT_INDEX[digit.joints[index + 1]]] = -digit.joint_radius[index + 1]
    for row, digit in zip(rows[COUPLINGS:], digits, strict=True):
        row[[JOINT_INDEX[name] for name in digit.joints]] = digit.joint_radius
    springs = [digit.spring_stiffness for digit in digits]
    return rows, np.concatenate([*(digit.segment_stiffness for digit in digits), springs])


def drive_arms(hand: Hand) -> Array:
    """Moment arms of the drives on their flexed root joints, shape (5,) [m]."""
    included = hand.guide_alpha - hand.synergy_max[:_CMC]
    chord = chord_from_included(hand.guide_sum, hand.guide_product, included)
    return 0.5 * hand.guide_product * np.sin(included) / chord


def drive_stiffness(digit: Digit) -> float:
    """Stiffness of a digit's drive as it is simulated, at most `RIGID` [N/m]."""
    return min(digit.drive_stiffness, RIGID)


def viscosities(hand: Hand, inertia: Array, ratio: float) -> tuple[Array, Array]:
    """The damping law of both engines: an element of stiffness k that moves the mass m is damped by
    2 ζ √(k m).

    Args:
        hand: the model's parameters.
        inertia: joint-space inertia at a typical posture, shape (15, 15) [kg·m²].
        ratio: ζ.

    Returns:
        Damping of the nine couplings and the five drives, whose roots are flexed [N·s/m], then of
        the CMC [N·m·s/rad], and their mobilities 1/m [1/kg, 1/(kg·m²)], shapes (15,).
    """
    compliance = np.linalg.inv(inertia)
    rows, stiffness = (element[:COUPLINGS] for element in element_rows(hand))
    coupling = np.einsum("ij,jk,ik->i", rows, compliance, rows)
    drive = drive_arms(hand) ** 2 * compliance[ROOTS, ROOTS]
    mobility = np.hstack([coupling, drive, compliance[_CMC_JOINT, _CMC_JOINT]])
    drives = [drive_stiffness(digit) for digit in hand.digits.values()]
    stiffness = np.hstack([stiffness, drives, hand.cmc_stiffness])
    return 2 * ratio * np.sqrt(stiffness / mobility), mobility


@dataclass(frozen=True, slots=True)
class Drive:
    """Driving tendon with stretch ``r u − (L₀ − chord(q))``: it only pulls, up to the servo's
    limit.

    Uses plain floats: for one tension per physics step, creating an array would cost more than the
    calculation."""

    joint: int
    """Index of the root joint."""
    alpha: float
    """Included angle between the guides at rest [rad]."""
    squares: float
    """d₁² + d₂² [m²]."""
    product: float
    """2 d₁ d₂ [m²]."""
    servo_radius: float
    """Radius r of the servo's hub [m]."""
    length: float
    """Chord at which the tendon is taut while the servo is at zero: L₀ plus the slack [m]."""
    stiffness: float
    """Stiffness of the tendon [N/m]."""
    limit: float
    """Largest tension that the servo can exert [N]."""
    viscosity: float = 0.0
    """Tension per rate of the stretch [N·s/m]."""
    brake: float = 0.0
    """Viscosity of a slack tendon against flexion faster than the servo's [N·s/m]."""

    @classmethod
    def of(cls, digit: Digit, slack: float = 0.0, strength: float = 1.0) -> Drive:
        """The undamped drive of a digit with `slack` [m], whose tension is limited to `strength`
        times its stall force.
        """
        return cls(
            JOINT_INDEX[digit.joints[0]],
            digit.alpha,
            digit.d1**2 + digit.d2**2,
            2 * digit.d1 * digit.d2,
            digit.servo_radius,
            digit.rest_chord + slack,
            drive_stiffness(digit),
            strength * digit.tension_limit,
        )

    def chord_and_arm(self, joint_pos: float) -> tuple[float, float]:
        """Distance of the guides and moment arm ``d₁ d₂ sin(α − q) / chord`` at a root angle [rad],
        both [m]. Eq. (3).
        """
        included = self.alpha - joint_pos
        chord = sqrt(self.squares - self.product * cos(included))
        return chord, 0.5 * self.product * sin(included) / chord

    def tension(
        self, joint_pos: float, joint_vel: float, servo: float, servo_vel: float
    ) -> tuple[float, float]:
        """Tension [N] and moment arm [m], from angles [rad] and speeds [rad/s] of the root joint
        and the horn.

        A braking drive's tension is negative.
        """
        chord, arm = self.chord_and_arm(joint_pos)
        radius = self.servo_radius
        stretch = radius * servo + chord - self.length
        rate = radius * servo_vel - arm * joint_vel
        if stretch > 0.0:
            pull = self.stiffness * stretch + self.viscosity * rate
            return (0.0 if pull < 0.0 else self.limit if pull > self.limit else pull), arm
        return (self.brake * rate if rate < 0.0 < joint_vel else 0.0), arm


class Tendons:
    """Torques of all tendons and springs of one hand.

    Damping coefficients are those of an implicit step: a coefficient c on an element that moves the
    mass m becomes c / (1 + c dt/m), which stays stable at any c. Calculations for the six drives
    use plain floats, which are faster than arrays of six; everything linear in the joints is one
    matrix product.

    Args:
        hand: the parameters.
        mass_matrix: joint-space inertia at a typical posture, shape (15, 15) [kg·m²]; only damping
            depends on it.
        dt: physics step [s].
        damping: damping of the tendons and joints.
        slack: slack that each drive winds up before it pulls, shape (5,) or () [m].
        strength: fraction of its stall force that each drive can exert, shape (5,) or ().

    Attributes:
        drives: the five driving tendons, by digit.
        fastest: largest ω dt of one tendon alone.
    """

    def __init__(
        self,
        hand: Hand,
        mass_matrix: Array,
        dt: float,
        damping: Damping,
        slack: ArrayLike = 0.0,
        strength: ArrayLike = 1.0,
    ) -> None:
        self.hand = hand
        viscosity, mobility = viscosities(hand, mass_matrix, 0.5)
        self.fastest = float((viscosity * mobility).max()) * dt
        viscosity *= 2 * damping.ratio
        viscosity /= 1 + viscosity * dt * mobility
        rows, stiffness = element_rows(hand)
        forces = stiffness[:, None] * rows
        springs = rows[COUPLINGS:]
        rows = rows[:COUPLINGS]
        self._coupling = forces[:COUPLINGS]
        self._spring_torque = springs.T @ forces[COUPLINGS:]
        stiffness_matrix = rows.T @ self._coupling + self._spring_torque
        viscosity_matrix = rows.T @ (viscosity[:COUPLINGS, None] * rows) + damping.joint * np.eye(
            len(JOINTS)
        )
        self._linear = -np.hstack([stiffness_matrix, viscosity_matrix])
        self._levers = np.abs(rows).T
        self._state = np.empty(2 * len(JOINTS))

        slacks, shares = (
            np.broadcast_to(given, len(hand.digits)).tolist() for given in (slack, strength)
        )
        *damped, self._cmc_viscosity = viscosity[COUPLINGS:].tolist()
        self.drives = tuple(
            replace(Drive.of(*given), viscosity=value, brake=damping.overrun * value)
            for *given, value in zip(hand.digits.values(), slacks, shares, damped, strict=True)
        )

    def load(self, joint_pos: ArrayLike, tension: Sequence[float]) -> Array:
        """Load of tendons and spring on every joint's guides: the sum of their absolute torques.

        Args:
            joint_pos: q, shape (15,) [rad].
            tension: tension of the drives, shape (5,) [N].

        Returns:
            Shape (15,) [N·m].
        """
        joint_pos = np.asarray(joint_pos)
        load = self._levers @ np.abs(self._coupling @ joint_pos) + self._spring_torque @ joint_pos
        for drive, pull in zip(self.drives, tension, strict=True):
            load[drive.joint] += pull * drive.chord_and_arm(joint_pos[drive.joint])[1]
        return np.maximum(load, 0.0)

    def torque(
        self,
        joint_pos: Sequence[float],
        joint_vel: Sequence[float],
        servo: Sequence[float],
        servo_vel: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Torque of all elements on every joint, and the tension of the drives.

        Args:
            joint_pos: q, shape (15,) [rad].
            joint_vel: shape (15,) [rad/s].
            servo: angles of the servos' horns, shape (6,) [rad].
            servo_vel: shape (6,) [rad/s].

        Returns:
            Torque, by joint [N·m], positive in flexion, and tension, by digit [N].
        """
        hand = self.hand
        state = self._state
        state[:] = (*joint_pos, *joint_vel)
        torque: list[float] = self._linear.dot(state).tolist()
        tensions = []
        for drive, horn, horn_vel in zip(self.drives, servo, servo_vel, strict=False):
            joint = drive.joint
            tension, arm = drive.tension(joint_pos[joint], joint_vel[joint], horn, horn_vel)
            torque[joint] += tension * arm
            tensions.append(tension)
        twist = hand.cmc_gain * servo[_CMC] - joint_pos[_CMC_JOINT]
        rate = hand.cmc_gain * servo_vel[_CMC] - joint_vel[_CMC_JOINT]
        pull = hand.cmc_stiffness * twist + self._cmc_viscosity * rate
        torque[_CMC_JOINT] += min(max(pull, -hand.cmc_torque_limit), hand.cmc_torque_limit)
        return torque, tensions
