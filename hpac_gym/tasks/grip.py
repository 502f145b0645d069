"""Grip of the hand on the object: whether it holds it, for how long, how far it slips, and how good
the grasp is.

The quality is the epsilon metric of Ferrari and Canny (1992). A contact can push along any direction
of its friction cone. The force together with its torque about the object's centre is a wrench;
epsilon is the radius of the largest ball about the origin inside the convex hull of all contacts'
wrenches: the smallest disturbance that contact forces adding up to 1 N cannot resist [N]. Zero when
some direction cannot be resisted at all."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from hpac_gym.model.checks import Array

MAX_SLIP = 0.02
"""Displacement of a carried object in the hand beyond which it counts as slipped out of the grasp
[m].
"""
CONE_EDGES = 6
"""Number of edges of the pyramid that approximates a friction cone."""


class Grip:
    """Tracks the grip in n worlds.

    The hand carries the object while it touches it and no support does; a single control step
    without contact does not end that, since an object shaken off one finger lands on another. It
    holds the object while it carries it without interruption and the slip since carrying began, or
    since `settle`, is at most `MAX_SLIP`.

    Attributes:
        carrying: True where the hand carries the object, shape (n,).
        time: duration of carrying without interruption, shape (n,) [s].
        slip: displacement of the object's centre in the hand since then, or since `settle`, shape
            (n,) [m].
        moved: displacement since the episode began, shape (n,) [m].
    """

    changing = ("carrying", "time", "slip", "moved", "_touched", "_origins")

    def __init__(self, num_worlds: int) -> None:
        self.carrying = np.zeros(num_worlds, dtype=bool)
        self.time = np.zeros(num_worlds)
        self.slip = np.zeros(num_worlds)
        self.moved = np.zeros(num_worlds)
        self._touched = np.zeros(num_worlds, dtype=bool)
        # Where the carrying began, and where the episode began.
        self._origins = np.zeros((2, num_worlds, 3))

    def start(self, worlds: Sequence[int], places: Sequence[Array]) -> None:
        """Begin episodes with the objects at their places in the hand frame [m]; nothing is
        carried.
        """
        index = np.asarray(worlds)
        self.carrying[index] = False
        self.time[index] = self.slip[index] = self.moved[index] = 0.0
        self._origins[1, index] = places

    def follow(
        self, object_pos: Array, touched: NDArray[np.bool_], supported: NDArray[np.bool_], dt: float
    ) -> None:
        """Advance by one control step of `dt` seconds.

        Args:
            object_pos: true centre of the object in the hand frame, shape (n, 3) [m].
            touched: True where the hand touches the object, shape (n,).
            supported: True where anything else supports the object, shape (n,).
            dt: control period [s].
        """
        carries = (touched | (self.carrying & self._touched)) & ~supported
        begins = carries & ~self.carrying
        if True in begins.tolist():  # in a third of the time of `any`
            self._origins[0, begins] = object_pos[begins]
        self._touched = touched
        self.carrying = carries
        self.time = (self.time + dt) * carries
        slip, self.moved = lengths(object_pos - self._origins)
        self.slip = np.where(carries, slip, 0.0)

    def settle(self, where: NDArray[np.bool_], object_pos: Array) -> None:
        """Set the slip of carried objects, at these places in the hand frame, shape (n, 3) [m], to
        zero: motion while the grasp forms is not slip.
        """
        where = where & self.carrying
        if True in where.tolist():
            self._origins[0, where] = object_pos[where]
            self.slip[where] = 0.0

    @property
    def firmness(self) -> Array:
        """1 − slip / `MAX_SLIP` for a carried object, but at least 0; 0 for one that is not
        carried, shape (n,).
        """
        return np.maximum(1.0 - self.slip / MAX_SLIP, 0.0) * self.carrying

    @property
    def holds(self) -> NDArray[np.bool_]:
        """True where the hand holds the object, shape (n,)."""
        return self.carrying & (self.slip <= MAX_SLIP)


def lengths(vectors: Array) -> Array:
    """Lengths of vectors, shape (..., 3) to (...,): `numpy.linalg.norm` without its checks."""
    return np.sqrt(np.add.reduce(vectors * vectors, axis=-1))


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
