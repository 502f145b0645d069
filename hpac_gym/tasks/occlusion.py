"""The hand as capsules: what it hides of an object from a camera, and what is in its way.

A surface point of an object is visible if it faces the camera and no capsule occludes it."""

from functools import lru_cache
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY, Box, Capsule, Geometry, rotation_from_rpy
from hpac_gym.body.object_models import Solid
from hpac_gym.model import JOINTS, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, matrix_from_quaternion
from hpac_gym.physics.supports import support_boxes

SKIN = 0.9
"""Fraction of a capsule's radius that occludes: a point under the edge of a touching finger stays
visible.
"""
ALONG = 9
"""Points along each link at which it is compared with the support, at most 8 mm apart."""
_AROUND = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])


class Skeleton:
    """Capsule models of n hands: three links per digit, then the palm.

    Args:
        num_worlds: n. All hands are nominal at first.

    Attributes:
        radius: radii of the capsules, shape (n, m) [m].
    """

    def __init__(self, num_worlds: int) -> None:
        digits = HPAC_GEOMETRY.digits
        self._joints = np.array(
            [[JOINTS.index(phalanx.joint) for phalanx in digit.phalanges] for digit in digits]
        )
        roots = [digit.phalanges[0] for digit in digits]
        rest = np.array([rotation_from_rpy(root.rpy) for root in roots])
        axes = np.array([root.axis for root in roots])
        cross = np.cross(axes[:, None], np.eye(3)).swapaxes(1, 2)
        # The root links' x and z axes, each at rest and by the sine and 1 − cosine of the angle.
        turns = rest, rest @ cross, rest @ cross @ cross
        self._axes = [[turn[:, :, axis] for turn in turns] for axis in (0, 2)]
        self._base = np.array([root.origin for root in roots])[:, None]
        palm = [part for solid in HPAC_GEOMETRY.palm_solids for part in _capsules(solid)]
        self._palm = np.array([[part.start for part in palm], [part.end for part in palm]])
        self._length = np.zeros((num_worlds, len(digits), 3, 1))
        self._end = np.zeros((num_worlds, len(digits), 3, 1))
        self.radius = np.zeros((num_worlds, 3 * len(digits) + len(palm)))
        self.radius[:, 3 * len(digits) :] = [part.radius for part in palm]
        for world in range(num_worlds):
            self.fit(world, HPAC_GEOMETRY)

    def fit(self, world: int, geometry: Geometry) -> None:
        """Set the links of one hand to those of a geometry with the nominal palm and joints."""
        links = [phalanx for digit in geometry.digits for phalanx in digit.phalanges]
        self._length[world].flat = [link.length for link in links]
        self._end[world].flat = [link.capsule.end[2] for link in links]
        self.radius[world, : len(links)] = [link.capsule.radius for link in links]

    def segments(self, joint_pos: Array, worlds: NDArray[np.int_]) -> Array:
        """Ends of the capsules' axes of some hands in the hand frame.

        Args:
            joint_pos: shape (k, 15) [rad].
            worlds: indices of the hands, shape (k,).

        Returns:
            shape (2, k, m, 3) [m].
        """
        angles = joint_pos[:, self._joints]
        root = angles[:, :, :1]
        across, ahead = (
            rest + np.sin(root) * by_sine + (1 - np.cos(root)) * by_cosine
            for rest, by_sine, by_cosine in self._axes
        )
        # The other two joints turn about the root link's y axis, so the digit stays in its plane.
        bend = (np.cumsum(angles, axis=2) - root)[..., None]
        along = np.sin(bend) * across[:, :, None] + np.cos(bend) * ahead[:, :, None]
        links = self._length[worlds] * along
        start = self._base + np.cumsum(links, axis=2) - links
        ends = np.array([start, start + self._end[worlds] * along])
        palm = np.broadcast_to(self._palm[:, None], (2, len(worlds), *self._palm.shape[1:]))
        return np.concatenate([ends.reshape(2, len(worlds), -1, 3), palm], axis=2)

    def thumb_in_finger(self, joint_pos: Array) -> bool:
        """True if the thumb of the first hand penetrates a finger at these joint angles, shape
        (15,) [rad].
        """
        ends = self.segments(joint_pos[None], np.array([0]))[:, 0]
        radius = self.radius[0]
        fingers = slice(3, len(JOINTS))
        bones = np.repeat(ends[:, None, fingers], 3, axis=1)
        wide = radius[fingers] + radius[:3, None]
        one = np.ones((3, 1), dtype=bool)
        return bool(covered(ends[0, :3], ends[1, :3, None], one, *bones, wide).any())


def _capsules(solid: Box | Capsule) -> list[Capsule]:
    """Capsules of a solid: the capsule itself, or a flat box approximated by a row of capsules
    along z.
    """
    if isinstance(solid, Capsule):
        return [solid]
    (x, y, z) = solid.center
    (thick, wide, tall) = solid.size
    radius = solid.size[0] / 2
    across = np.linspace(
        y - wide / 2 + radius, y + wide / 2 - radius, int(np.ceil(wide / thick)) + 1
    ).tolist()
    half = tall / 2 - radius
    return [Capsule((x, place, z - half), (x, place, z + half), radius) for place in across]


def covered(
    eye: Array,
    points: Array,
    asked: NDArray[np.bool_],
    first: Array,
    second: Array,
    radius: Array,
) -> NDArray[np.bool_]:
    """True where a capsule occludes an asked point from the eye.

    Based on the shortest distance between two segments, the line of sight and the capsule's axis:
    Ericson, Real-Time Collision Detection (2005), section 5.1.9.

    Args:
        eye: position of the eye in each world, shape (n, 3) [m].
        points: shape (n, p, 3) [m].
        asked: the points to examine, shape (n, p); the others are not occluded.
        first: ends of the capsules' axes, shape (n, m, 3) [m].
        second: the other ends, shape (n, m, 3) [m].
        radius: radii of the capsules, shape (n, m) [m].

    Returns:
        shape (n, p).
    """
    world, point = asked.nonzero()
    ray = points - eye[:, None]
    bone = second - first
    way = eye[:, None] - first
    # A row for every asked point, a column for every capsule.
    b = (ray @ bone.swapaxes(1, 2))[world, point]
    c = (ray @ way.swapaxes(1, 2))[world, point]
    a = dots(ray, ray)[world, point, None]
    e = dots(bone, bone)[world]
    f = dots(bone, way)[world]
    excess = (dots(way, way) - (SKIN * radius) ** 2)[world]
    along = ((b * f - c * e) / (a * e - b * b).clip(1e-18)).clip(0.0, 1.0)
    across = ((b * along + f) / e).clip(0.0, 1.0)
    along = ((b * across - c) / a).clip(0.0, 1.0)
    distance = along * (along * a + 2 * (c - across * b)) + excess + across * (across * e - 2 * f)
    found = np.zeros(asked.shape, dtype=bool)
    found[world, point] = (distance < 0.0).any(axis=1)
    return found


def dots(first: Array, second: Array) -> Array:
    """Scalar products of vectors, shapes (..., 3) to (...,): for a single hand in a quarter of the
    time of `numpy.einsum`.
    """
    return (first * second) @ np.ones(3)


@lru_cache(maxsize=1024)
def surface(name: str, solids: tuple[Solid, ...], count: int) -> tuple[Array, Array]:
    """Uniformly random points of an object's surface [m], and their outward normals, shapes (count,
    3), read-only.

    The name is the seed, so that an object always has the same points, of which fewer are the first
    ones. Points inside another solid are left out.

    Args:
        name: name of the object.
        solids: solids of the object.
        count: number of points.
    """
    rng = np.random.default_rng(crc32(name.encode()))
    areas = np.array([_area(solid) for solid in solids])
    found = np.zeros((2, 0, 3))
    while found.shape[1] < count:
        # Chosen for many points at a time, which are then drawn as far as they are needed.
        for part in np.split(rng.choice(len(solids), 320, p=areas / areas.sum()), 10):
            if found.shape[1] >= count:
                break
            drawn = np.array([_on_surface(solids[index], rng) for index in part]).swapaxes(0, 1)
            buried = [
                inside(solid, drawn[0]) & (part != index) for index, solid in enumerate(solids)
            ]
            found = np.concatenate([found, drawn[:, ~np.any(buried, axis=0)]], axis=1)
    found.setflags(write=False)
    return found[0, :count], found[1, :count]


def _area(solid: Solid) -> float:
    x, y, z = solid.size
    if solid.kind == "box":
        return 2 * (x * y + y * z + z * x)
    if solid.kind == "hull":
        return float(_triangles(solid)[2].sum())
    if solid.kind == "cylinder":
        return np.pi * x * (z + x / 2)
    return np.pi * x * z  # also for a sphere, whose length is its width; a capsule's ends form one


@lru_cache(maxsize=64)
def _triangles(solid: Solid) -> tuple[Array, Array, Array]:
    """Corners of a hull's faces, shape (m, 3, 3) [m], their outward normals, and their areas
    [m²].
    """
    corners = solid.hull.vertices[solid.hull.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(across, axis=1, keepdims=True)
    return corners, across / double, double[:, 0] / 2


def _on_surface(solid: Solid, rng: np.random.Generator) -> tuple[Array, Array]:
    """Random point of a solid's surface and its normal, in the object's axes."""
    half = np.array(solid.size) / 2
    if solid.kind == "box":
        faces = np.array([half[1] * half[2], half[0] * half[2], half[0] * half[1]])
        axis = rng.choice(3, p=faces / faces.sum())
        place = rng.uniform(-half, half)
        normal = np.zeros(3)
        normal[axis] = rng.choice([-1.0, 1.0])
        place[axis] = normal[axis] * half[axis]
    elif solid.kind == "hull":
        corners, normals, areas = _triangles(solid)
        face = rng.choice(len(areas), p=areas / areas.sum())
        place = rng.dirichlet(np.ones(3)) @ corners[face]
        normal = normals[face]
    elif solid.kind == "cylinder":
        angle = rng.uniform(0, 2 * np.pi)
        radius = half[0]
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        if rng.random() < radius / (radius + 2 * half[2]):
            normal = np.array([0.0, 0.0, rng.choice([-1.0, 1.0])])
            place = radius * np.sqrt(rng.random()) * out + half[2] * normal
        else:
            place = radius * out + [0.0, 0.0, rng.uniform(-half[2], half[2])]
            normal = out
    else:
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        place = half[0] * normal
        middle = half[2] - half[0]
        if rng.random() < middle / half[2]:
            normal = np.array([*normal[:2], 0.0]) / np.hypot(*normal[:2])
            place = half[0] * normal + [0.0, 0.0, rng.uniform(-middle, middle)]
        else:
            place[2] += np.copysign(middle, normal[2])
    return solid.center + solid.rotation @ place, solid.rotation @ normal


def inside(solid: Solid, points: Array) -> NDArray[np.bool_]:
    """True where points in the object's frame, shape (p, 3) [m], are inside a solid."""
    own = (points - solid.center) @ solid.rotation
    half = np.array(solid.size) / 2
    if solid.kind == "box":
        return (np.abs(own) < half).all(axis=1)
    if solid.kind == "hull":
        corners, normals, _ = _triangles(solid)
        return (own @ normals.T < (corners[:, 0] * normals).sum(axis=1)).all(axis=1)
    if solid.kind == "cylinder":
        return (np.hypot(own[:, 0], own[:, 1]) < half[0]) & (np.abs(own[:, 2]) < half[2])
    middle = half[2] - half[0]
    own[:, 2] -= np.clip(own[:, 2], -middle, middle)
    return np.linalg.norm(own, axis=1) < half[0]


def in_the_way(setup: SceneSetup) -> bool:
    """True if the hand at the start of an episode has its thumb inside a finger, or penetrates the
    support of its object or the table.

    Judged by geometry: a digit that is wedged against a support stays about its joint's stop.
    """
    joint_pos = joints_from_synergy(setup.synergy, setup.hand)
    if _SKELETON.thumb_in_finger(joint_pos):
        return True
    bones = HAND_POSITION + _bones(joint_pos) @ setup.hand_rotation.T
    for box in support_boxes(setup):
        own = (bones - box.centre) @ matrix_from_quaternion(box.quaternion)
        distance = np.linalg.norm(np.maximum(np.abs(own) - box.half_extents, 0.0), axis=-1)
        if (distance < SKIN * _SKELETON.radius[0]).any():
            return True
    return False


def points_in_object(setup: SceneSetup, skin: float = 0.0) -> int:
    """How many points of the hand are inside the object at the start of an episode: those along the
    axes of its links and palm, and with a `skin` others at this fraction of the radius about them.
    """
    if setup.object is None:
        return 0
    turn = setup.hand_rotation.T @ matrix_from_quaternion(setup.object_turn[0])
    bones = _bones(joints_from_synergy(setup.synergy, setup.hand))
    own = (bones - setup.position) @ turn
    offsets = _AROUND if skin else _AROUND[:1]
    around = skin * _SKELETON.radius[0][:, None, None] * offsets
    points = (own[:, :, None] + around).reshape(-1, 3)
    solids = setup.object.solid_model.solids
    return sum(int(inside(solid, points).sum()) for solid in solids)


def _bones(joint_pos: Array) -> Array:
    """Points along the axes of the hand's capsules, in the hand frame, shape (`ALONG`, m, 3) [m]."""
    first, second = (ends[0] for ends in _SKELETON.segments(joint_pos[None], np.array([0])))
    return first + np.linspace(0, 1, ALONG)[:, None, None] * (second - first)


_SKELETON = Skeleton(1)
