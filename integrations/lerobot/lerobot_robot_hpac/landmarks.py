"""21 landmarks of a human right hand, as hand trackers number them, to the six synergies.

Each servo takes the synergy at which the model's digit flexes by as much, all its joints together,
as the human digit; the thumb's CMC takes the angle by which the thumb's metacarpal has left the
plane of the palm. The H-PAC hand's own landmarks give its own synergies back."""

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.body.geometry import HPAC_GEOMETRY, link_poses
from hpac_gym.errors import ShapeError
from hpac_gym.model import DIGITS, HPAC
from hpac_gym.model.checks import Array

LANDMARKS = 21
"""Wrist, then four of each digit from thumb to pinky, from the palm outwards."""
_SERVO = HPAC.servo_of_joint
_FLEXION = np.bincount(_SERVO, HPAC.elastic_ratio)[: len(DIGITS)]
"""Flexion of a digit's joints together, per synergy [rad/rad]."""
_CMC = np.linspace(0.0, HPAC.synergy_max[-1], 32)


def _opposition(along: Array) -> Array:
    """Angle of the thumb's metacarpal from the palm's plane, about the hand's long axis [rad]."""
    return np.arctan2(along[..., 0], along[..., 1])


_OPPOSED = _opposition(
    np.array([link_poses(HPAC_GEOMETRY.digit("thumb"), [cmc, 0, 0])[0][1][:, 2] for cmc in _CMC])
)
"""That angle of the H-PAC hand, at each of `_CMC`."""


def synergy_from_landmarks(points: ArrayLike) -> Array:
    """Synergies for the landmarks of a right hand.

    Args:
        points: shape (21, 3), in any unit, right-handed axes.

    Returns:
        Shape (6,) [rad], within Table I.

    Raises:
        ShapeError: Another shape, not finite, or no palm: wrist and knuckles in one line.
    """
    points = np.asarray(points, dtype=float)
    if points.shape != (LANDMARKS, 3) or not np.isfinite(points).all():
        raise ShapeError(f"landmarks must be {LANDMARKS} × 3 finite numbers, not {points.shape}")
    knuckles = points[[5, 9, 13, 17]] - points[0]
    up = knuckles[1] + knuckles[2]
    palmar = np.cross(knuckles[0] - knuckles[3], up)
    if not np.linalg.norm(palmar) > 1e-9 * np.linalg.norm(up) ** 2:
        raise ShapeError("landmarks: wrist and knuckles are in one line")
    axes = np.stack([palmar, np.cross(up, palmar), up])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    digits = points[1:].reshape(len(DIGITS), 4, 3) @ axes.T
    bones = np.diff(digits, axis=1)
    bones /= np.maximum(np.linalg.norm(bones, axis=2, keepdims=True), 1e-12)
    bends = np.arccos(np.clip((bones[:, 1:] * bones[:, :-1]).sum(axis=2), -1.0, 1.0))
    flexion = bends.sum(axis=1)
    flexion[1:] += np.arctan2(bones[1:, 0, 0], bones[1:, 0, 2])  # of the knuckles, from the palm
    cmc = np.interp(_opposition(bones[0, 0]), _OPPOSED, _CMC)
    return np.clip([*(flexion / _FLEXION), cmc], HPAC.synergy_min, HPAC.synergy_max)
