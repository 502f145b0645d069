"""Grasp quality: the epsilon metric of Ferrari and Canny (1992).

A contact can push along any direction of its friction cone. The force together with its torque
about the object's centre is a wrench; epsilon is the radius of the largest ball about the origin
inside the convex hull of all contacts' wrenches: the smallest disturbance that contact forces
adding up to 1 N cannot resist [N]. Zero when some direction cannot be resisted at all."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from hpac_gym.model.checks import Array

CONE_EDGES = 6
"""Number of edges of the pyramid that approximates a friction cone."""


def contact_wrenches(
    point: Array, normal: Array, friction: float, centre: Array, length: float
) -> Array:
    """The primitive wrenches: every edge of every contact's friction cone, with a normal force of 1
    N.

    Args:
        point: contact points, shape (n, 3) [m].
        normal: contact normals, unit vectors into the object, shape (n, 3).
        friction: Coulomb coefficient.
        centre: reference point of the torques, shape (3,) [m].
        length: characteristic length by which torques are divided, to compare with forces [m].

    Returns:
        shape (n · CONE_EDGES, 6) [N].
    """
    helper = np.where(np.abs(normal[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(normal, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(normal, first)
    angle = 2 * np.pi * np.arange(CONE_EDGES)[:, None, None] / CONE_EDGES
    force = normal + friction * (np.cos(angle) * first + np.sin(angle) * second)
    torque = np.cross(point - centre, force) / length
    return np.concatenate([force, torque], axis=-1).reshape(-1, 6)


def largest_ball(points: Array) -> float:
    """Radius of the largest ball about the origin inside the convex hull of points, shape (n, d); 0
    if there is none.
    """
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # too few points, or coplanar ones
        return 0.0
    return max(0.0, float(-hull.equations[:, -1].max()))
