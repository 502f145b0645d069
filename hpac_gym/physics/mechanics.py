"""The numbers of one hand's mechanics, for an engine that has joints, tendons and drives as elements of
its model: armature, joint-space inertia, and the parameters of tendons, springs and drives."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from hpac_gym.body.geometry import Geometry, link_poses, rotation_from_rpy
from hpac_gym.body.urdf import solid_inertia
from hpac_gym.model import DIGITS, HPAC, JOINT_INDEX, JOINTS, SERVOS, Hand, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.settings import HandSettings
from hpac_gym.physics.tendons import (
    COUPLINGS,
    ROOTS,
    drive_arms,
    drive_stiffness,
    element_rows,
    viscosities,
)

GUIDE_TILT = 0.35
"""Angle from a link's axis to its guide, towards the palm [rad]; only the guides' included angle
affects the physics.
"""
_PLACE = {"mcp": 0, "mp": 0, "cmc": 0, "pip": 1, "ip": 1, "dip": 2}


def armature_of(joint: str, armature: tuple[float, float, float]) -> float:
    """Inertia added to a joint's link about every axis [kg·m²], the same in both engines, of
    `HandSettings.armature`.
    """
    return armature[_PLACE[joint.split("_")[1]]]


def mass_matrix(
    geometry: Geometry, armature: tuple[float, float, float], synergy: Array, hand: Hand = HPAC
) -> Array:
    """Joint-space inertia of the fifteen joints with the palm at rest, shape (15, 15) [kg·m²].

    Args:
        geometry: the hand's body.
        armature: inertia added to the links, as in `HandSettings` [kg·m²].
        synergy: posture, on the hand's manifold, shape (6,) [rad].
        hand: the model's parameters.
    """
    matrix = np.zeros((len(JOINTS), len(JOINTS)))
    for digit in geometry.digits:
        index = [JOINT_INDEX[phalanx.joint] for phalanx in digit.phalanges]
        poses = link_poses(digit, joints_from_synergy(synergy, hand)[index])
        axes = [
            rotation @ phalanx.axis
            for phalanx, (_, rotation) in zip(digit.phalanges, poses, strict=True)
        ]
        for last, (phalanx, (position, rotation)) in enumerate(
            zip(digit.phalanges, poses, strict=True)
        ):
            center, inertia = solid_inertia((phalanx.capsule,), phalanx.mass)
            inertia = inertia + armature_of(phalanx.joint, armature) * np.eye(3)
            inertia = rotation @ inertia @ rotation.T
            turn = np.array(axes[: last + 1])
            arms = position + rotation @ center - [origin for origin, _ in poses[: last + 1]]
            slide = np.cross(turn, arms)
            matrix[np.ix_(index[: last + 1], index[: last + 1])] += (
                phalanx.mass * slide @ slide.T + turn @ inertia @ turn.T
            )
    return matrix


@dataclass(frozen=True, slots=True)
class Mechanics:
    """Parameters of one hand's tendons, springs and drives, in the order of the model's
    elements.
    """

    rows: Array
    """Length of each coupling, then of each spring, per joint angle, shape (14, 15) [m/rad]."""
    stiffness: Array
    """Stiffness of couplings and springs, shape (14,) [N/m]."""
    damping: Array
    """Damping of couplings and springs, shape (14,) [N·s/m]."""
    guides: Array
    """Guides of each drive: the fixed one in its root joint's parent, then the moving one in its
    link, shape (5, 2, 3) [m].
    """
    hub_mass: Array
    """Reflected inertia of each servo's rotor and gears, as a mass that moves with its tendon,
    shape (5,) [kg].
    """
    gain: Array
    """Force of each servo's drive per angle of its horn, shape (6,) [N/rad], for the CMC [N·m/rad].
    """
    bias: Array
    """Force of each drive at angle 0, per its tendon's length, and per its speed, shape (6, 3) [N,
    N/m, N·s/m], for the CMC [N·m, N·m/rad, N·m·s/rad]. A tendon pulls with a negative force."""
    limit: Array
    """Lowest and highest force of each drive, shape (6, 2) [N], for the CMC [N·m]."""

    @classmethod
    def of(
        cls, hand: Hand, settings: HandSettings, inertia: Array, geometry: Geometry
    ) -> Mechanics:
        """Compute the parameters of a hand.

        Args:
            hand: the model's parameters.
            settings: settings of the simulated hand.
            inertia: `mass_matrix` at half stroke, shape (15, 15) [kg·m²]; only damping depends on
                it.
            geometry: the hand's body.
        """
        digits = list(hand.digits.values())
        rows, element_stiffness = element_rows(hand)
        hub_mass = settings.hub_inertia / hand.servo_radius**2
        stiffness = np.array([drive_stiffness(digit) for digit in digits])
        inertia = inertia.copy()
        inertia[ROOTS, ROOTS] += hub_mass * drive_arms(hand) ** 2
        inertia[-1, -1] += settings.hub_inertia / hand.cmc_gain**2  # the last joint is the CMC
        viscosity, _ = viscosities(hand, inertia, settings.damping.ratio)
        coupling_damping, drive_damping = np.split(viscosity[:-1], [COUPLINGS])
        length = hand.rest_chord + np.broadcast_to(settings.slack, len(digits))
        tension = np.array([digit.tension_limit for digit in digits]) * settings.strength
        drives = np.stack([stiffness * length, -stiffness, -drive_damping], axis=1)
        limits = np.stack([-tension, np.zeros_like(tension)], axis=1)
        return cls(
            rows,
            element_stiffness,
            np.append(coupling_damping, np.zeros(len(digits))),
            _guides(hand, *_root_frames(geometry)),
            hub_mass,
            np.append(-stiffness * hand.servo_radius, hand.cmc_stiffness * hand.cmc_gain),
            np.vstack([drives, (0.0, -hand.cmc_stiffness, -viscosity[-1])]),
            np.vstack([limits, (-hand.cmc_torque_limit, hand.cmc_torque_limit)]),
        )


@lru_cache(maxsize=64)
def _root_frames(geometry: Geometry) -> tuple[Array, Array]:
    """Origins, shape (5, 3) [m], and rotations, shape (5, 3, 3), of the driven links at rest in
    their parents' frames.
    """
    links = {phalanx.joint: phalanx for phalanx in geometry.phalanges}
    roots = [links[joint] for joint in SERVOS[:-1]]
    return np.array([link.origin for link in roots]), np.array(
        [rotation_from_rpy(link.rpy) for link in roots]
    )


def _guides(hand: Hand, origins: Array, rotations: Array) -> Array:
    guides = np.zeros((len(DIGITS), 2, 3))
    tilt = GUIDE_TILT + hand.guide_alpha
    d1, d2 = np.array([(digit.d1, digit.d2) for digit in hand.digits.values()]).T
    fixed = np.stack([d1 * np.sin(tilt), np.zeros(len(tilt)), d1 * np.cos(tilt)], axis=1)
    guides[:, 0] = origins + (rotations @ fixed[:, :, None])[:, :, 0]
    guides[:, 1, 0] = d2 * np.sin(GUIDE_TILT)
    guides[:, 1, 2] = d2 * np.cos(GUIDE_TILT)
    return guides
