"""How well a grasp resists: the epsilon figure of Ferrari and Canny (1992).

A contact can push along any direction of its friction cone. The force together with its torque about the object's centre is a
wrench; epsilon is the radius of the largest ball about the origin inside the convex hull of all contacts' wrenches: the
smallest disturbance that contact forces adding up to 1 N cannot resist [N]. Zero when some direction cannot be resisted at all.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from hpac_gym.model.checks import Array
from hpac_gym.sim import Scene
from hpac_gym.sim.truth import contacts

CONE_EDGES = 6
"""Edges of the pyramid that stands for a friction cone."""
_TOLERANCE = 1e-9
_MOST_FACETS = 20_000


def grasp_quality(scene: Scene) -> float:
    """Epsilon of the grasp that a scene shows now [N]; torques are divided by the object's largest half extent.

    It takes milliseconds where a step takes one, so that environments give it once, with an episode's last step.
    """
    touching = contacts(scene)
    if len(touching.point) < 2:
        return 0.0
    centre, length = scene.object.pose()[0], max(scene.object.spec.half_extents)
    return largest_ball(contact_wrenches(touching.point, touching.normal, touching.friction, centre, length))


def contact_wrenches(point: Array, normal: Array, friction: float, centre: Array, length: float) -> Array:
    """The primitive wrenches: every edge of every contact's friction cone, with a normal force of 1 N.

    Args:
        point: of each contact, shape (n, 3) [m].
        normal: into the object, unit vectors, shape (n, 3).
        friction: Coulomb coefficient.
        centre: about which torques are taken, shape (3,) [m].
        length: what torques are divided by, so that they compare with forces [m].

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
    """Radius of the largest ball about the origin inside the convex hull of points, shape (n, d); 0 if there is none.

    A polytope inside the hull grows at the facet that is nearest to the origin until no point lies beyond it: then that
    facet is the hull's own. Facets that are far from the origin are never refined.
    """
    simplex = _simplex(points)
    if simplex is None:
        return 0.0
    inside = points[simplex].mean(axis=0)
    size = points.shape[1]
    facets = np.sort(list(combinations(simplex, size)), axis=1)
    without = np.array([[corner for corner in range(size) if corner != left_out] for left_out in range(size)])
    digits = len(points) ** np.arange(size - 1)
    normals, offsets = _planes(points, facets, inside)
    while len(facets) < _MOST_FACETS:
        nearest = int(np.argmin(offsets))
        reach = points @ normals[nearest]
        farthest = int(np.argmax(reach))
        if reach[farthest] <= offsets[nearest] + _TOLERANCE:
            return max(0.0, float(offsets[nearest]))
        visible = normals @ points[farthest] > offsets + _TOLERANCE
        ridges = facets[visible][:, without].reshape(-1, size - 1)  # corners of a facet stay in order
        _, first, count = np.unique(ridges @ digits, return_index=True, return_counts=True)
        horizon = ridges[first[count == 1]]
        new = np.sort(np.column_stack([horizon, np.full(len(horizon), farthest)]), axis=1)
        new_normals, new_offsets = _planes(points, new, inside)
        facets = np.concatenate([facets[~visible], new])
        normals = np.concatenate([normals[~visible], new_normals])
        offsets = np.concatenate([offsets[~visible], new_offsets])
    return max(0.0, float(offsets.min()))


def _simplex(points: Array) -> list[int] | None:
    """Indices of d + 1 points that span the space, far apart; None if the points are flat."""
    if not len(points):
        return None
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(axis=0), axis=1)))]
    rest = points - points[chosen[0]]
    size = np.abs(rest).max(initial=0.0)
    for _ in range(points.shape[1]):
        distance = np.linalg.norm(rest, axis=1)
        farthest = int(np.argmax(distance))
        if distance[farthest] <= 1e-6 * size:
            return None
        chosen.append(farthest)
        axis = rest[farthest] / distance[farthest]
        rest = rest - np.outer(rest @ axis, axis)
    return chosen


def _planes(points: Array, facets: Array, inside: Array) -> tuple[Array, Array]:
    """Outward unit normals, shape (m, d), and offsets, shape (m,), of facets."""
    corners = points[facets] - inside
    try:
        normals = np.linalg.solve(corners, np.ones((len(facets), points.shape[1], 1)))[..., 0]
    except np.linalg.LinAlgError:  # a flat facet; its plane is whichever one holds it
        normals = np.linalg.pinv(corners).sum(axis=-1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = np.einsum("ij,ij->i", normals, corners[:, 0])
    return normals, offsets + normals @ inside
