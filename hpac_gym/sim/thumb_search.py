"""How well the thumb opposes each finger: ``python -m hpac_gym.sim.thumb_search`` prints postures and distances.

Run it after a change to the body and put the postures that it prints into ``data/geometry.toml``. The search moves thumb MP,
CMC and the finger's MCP; the other joints follow on the elastic manifold, so a posture found is one that six servos can take.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpac_gym.model import FINGERS, HPAC, JOINT_INDEX, SERVO_INDEX, SERVOS, joints_from_synergy
from hpac_gym.sim.geometry import Array, Geometry, link_poses, load_geometry

CLEARANCE = 1e-4
"""Distance that the search leaves between the two fingertips [m]."""
_GAP_WEIGHT = 10.0  # touching counts more than touching in the middle of the pads
_STARTS = ((0.6, 0.3, 0.6), (1.0, 0.4, 0.8), (1.4, 0.6, 0.8))
_STEP = 1e-6
_SAMPLES = np.linspace(0.0, 1.0, 101)[:, None]


@dataclass(frozen=True, slots=True)
class Opposition:
    """One posture in which the thumb meets a finger."""

    synergy: Array
    """Shape (6,) [rad]."""
    gap: float
    """Between the surfaces of the two distal links, negative where they overlap [m]."""
    pad_distance: float
    """Between the two pads' centres [m]."""
    pad_angle: float
    """Between one pad's normal and the other's reversed [rad]."""


def find_opposition(geometry: Geometry, finger: str) -> Opposition:
    """The posture that brings the thumb's pad onto a finger's, the surfaces `CLEARANCE` apart.

    Levenberg–Marquardt from a few starts over CMC, thumb MP and the finger's MCP, within Table I.
    """
    found = [_meet(geometry, finger, np.array(start)) for start in _STARTS]
    synergy = min(found, key=lambda synergy: np.sum(_residual(geometry, finger, synergy) ** 2))
    offset, gap, angle = _contact(geometry, finger, synergy)
    return Opposition(synergy, gap, float(np.linalg.norm(offset)), angle)


def _meet(geometry: Geometry, finger: str, coordinates: Array, iterations: int = 60) -> Array:
    moved = [SERVO_INDEX[name] for name in ("thumb_cmc", "thumb_mp", f"{finger}_mcp")]
    synergy, damping = np.zeros(len(SERVOS)), 1e-3
    synergy[moved] = coordinates
    residual = _residual(geometry, finger, synergy)
    for _ in range(iterations):
        jacobian = np.empty((len(residual), len(moved)))
        for column, index in enumerate(moved):
            nudged = synergy.copy()
            nudged[index] += _STEP
            jacobian[:, column] = (_residual(geometry, finger, nudged) - residual) / _STEP
        normal = jacobian.T @ jacobian
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual)
        trial = synergy.copy()
        trial[moved] -= step
        trial = np.clip(trial, HPAC.synergy_min, HPAC.synergy_max)
        trial_residual = _residual(geometry, finger, trial)
        better = trial_residual @ trial_residual < residual @ residual
        damping = max(damping / 4, 1e-9) if better else min(damping * 4, 1e6)
        if better:
            synergy, residual = trial, trial_residual
    return synergy


def _residual(geometry: Geometry, finger: str, synergy: Array) -> Array:
    offset, gap, _ = _contact(geometry, finger, synergy)
    return np.array([*offset, _GAP_WEIGHT * (gap - CLEARANCE)])


def _contact(geometry: Geometry, finger: str, synergy: Array) -> tuple[Array, float, float]:
    """Offset between the pads (3,) [m], gap between the distal links [m], angle between the pads' normals [rad]."""
    angles = joints_from_synergy(synergy)
    pads, normals, segments, reach = [], [], [], 0.0
    for digit in (geometry.digit("thumb"), geometry.digit(finger)):
        own = np.array([angles[JOINT_INDEX[phalanx.joint]] for phalanx in digit.phalanges])
        position, rotation = link_poses(digit, own)[-1]
        capsule = digit.phalanges[-1].capsule
        pads.append(position + rotation @ digit.pad)
        normals.append(rotation @ digit.pad_normal)
        segments.append((position + rotation @ capsule.start, position + rotation @ capsule.end))
        reach += capsule.radius
    angle = np.arccos(np.clip(-normals[0] @ normals[1], -1.0, 1.0))
    return pads[0] - pads[1], _segment_distance(*segments) - reach, float(angle)


def _segment_distance(one: tuple[Array, Array], other: tuple[Array, Array]) -> float:
    """Distance of two segments [m]: the first one sampled, the second one exact."""
    points = one[0] + _SAMPLES * (one[1] - one[0])
    along = other[1] - other[0]
    foot = np.clip((points - other[0]) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(points - other[0] - foot[:, None] * along, axis=1).min())


def main() -> None:
    geometry = load_geometry()
    for finger in FINGERS:
        found = find_opposition(geometry, finger)
        print(
            f"{finger:6} = {np.round(found.synergy, 3).tolist()}  # gap {1e3 * found.gap:.2f} mm, "
            f"pads {1e3 * found.pad_distance:.2f} mm apart, normals {np.degrees(found.pad_angle):.0f} deg"
        )


if __name__ == "__main__":
    main()
