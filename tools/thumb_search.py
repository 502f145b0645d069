"""Opposition of the thumb to each finger: ``python -m tools.thumb_search`` prints postures and
distances.

Run it after a change to the body and copy the printed postures to
``hpac_gym/body/data/geometry.toml``. The search varies thumb MP, CMC and the finger's MCP; the
other joints follow on the elastic manifold, so the six servos can reach every posture found."""

import numpy as np
from scipy.optimize import least_squares

from hpac_gym.body.geometry import Array, Geometry, link_poses, load_geometry
from hpac_gym.model import FINGERS, HPAC, JOINT_INDEX, SERVO_INDEX, SERVOS, joints_from_synergy

CLEARANCE = 1e-4
"""Target distance between the two fingertips [m]."""
_GAP_WEIGHT = 10.0  # the gap counts more than the alignment of the pads
_STARTS = ((0.6, 0.3, 0.6), (1.0, 0.4, 0.8), (1.4, 0.6, 0.8))
_SAMPLES = np.linspace(0.0, 1.0, 101)[:, None]


def find_opposition(geometry: Geometry, finger: str) -> Array:
    """Synergy with the thumb's pad opposite a finger's, surfaces `CLEARANCE` apart, shape (6,) [rad]:
    the best of a few starts.
    """
    moved = [SERVO_INDEX[name] for name in ("thumb_cmc", "thumb_mp", f"{finger}_mcp")]
    bounds = HPAC.synergy_min[moved], HPAC.synergy_max[moved]

    def synergy_of(coordinates: Array) -> Array:
        synergy = np.zeros(len(SERVOS))
        synergy[moved] = coordinates
        return synergy

    def residual(coordinates: Array) -> Array:
        offset, gap, _ = contact(geometry, finger, synergy_of(coordinates))
        return np.array([*offset, _GAP_WEIGHT * (gap - CLEARANCE)])

    # Lengths are in metres and angles in radians: tolerances relative to a cost of about 1e-6 m²
    # must be tight.
    fits = [
        least_squares(residual, start, bounds=bounds, ftol=1e-12, xtol=1e-12, gtol=1e-15)
        for start in _STARTS
    ]
    return synergy_of(min(fits, key=lambda fit: fit.cost).x)


def contact(geometry: Geometry, finger: str, synergy: Array) -> tuple[Array, float, float]:
    """Offset between the centres of the pads (3,) [m]; distance between the surfaces of the distal
    links, negative if they overlap [m]; angle between one pad's normal and the other's reversed [rad].
    """
    angles = joints_from_synergy(synergy)
    pads = []
    normals = []
    segments = []
    reach = 0.0
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
    """Distance between two segments [m], with the first one sampled."""
    points = one[0] + _SAMPLES * (one[1] - one[0])
    along = other[1] - other[0]
    foot = np.clip((points - other[0]) @ along / (along @ along), 0.0, 1.0)
    return float(np.linalg.norm(points - other[0] - foot[:, None] * along, axis=1).min())


def main() -> None:
    """Print the best posture for each finger."""
    geometry = load_geometry()
    for finger in FINGERS:
        synergy = find_opposition(geometry, finger)
        offset, gap, angle = contact(geometry, finger, synergy)
        print(
            f"{finger:6} = {np.round(synergy, 3).tolist()}  # gap {1e3 * gap:.2f} mm, "
            f"pads {1e3 * np.linalg.norm(offset):.2f} mm apart, normals {np.degrees(angle):.0f} deg"
        )


if __name__ == "__main__":
    main()
