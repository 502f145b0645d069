"""The solids of hand, object and supports as triangles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hpac_gym.body.geometry import Box, Capsule, Geometry
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.urdf import COLORS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import OBJECT_COLORS

AROUND = 28
"""Corners of a circle."""
Color = tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles in the frame of their body."""

    vertices: Array
    """Shape (n, 3) [m]."""
    faces: NDArray[np.int_]
    """Shape (m, 3)."""
    color: Color
    """RGB, each in [0, 1]."""
    flat: bool = False
    """Whether its edges are sharp."""

    def moved(self, place: Array, turn: Rotation | None = None) -> Mesh:
        """The mesh turned, and moved by a way, shape (3,) [m]."""
        turned = self.vertices if turn is None else turn.apply(self.vertices)
        return Mesh(turned + place, self.faces, self.color, self.flat)


def revolved(profile: Array, color: Color) -> Mesh:
    """A solid of revolution about z, for radii and heights from below upwards, shape (k, 2) [m]."""
    turn = np.linspace(0, 2 * np.pi, AROUND, endpoint=False)
    radius, height = np.asarray(profile, dtype=float).T
    vertices = np.stack(
        [
            np.outer(radius, np.cos(turn)),
            np.outer(radius, np.sin(turn)),
            np.repeat(height[:, None], AROUND, axis=1),
        ],
        axis=2,
    ).reshape(-1, 3)
    here = np.arange(AROUND)
    beside = (here + 1) % AROUND
    rows = AROUND * np.arange(len(profile) - 1)[:, None]
    lower = np.stack([rows + here, rows + beside, rows + AROUND + beside], axis=2)
    upper = np.stack([rows + here, rows + AROUND + beside, rows + AROUND + here], axis=2)
    return Mesh(vertices, np.concatenate([lower, upper]).reshape(-1, 3), color)


def solid(kind: str, half: tuple[float, float, float], color: Color) -> Mesh:
    """A sphere, capsule, cylinder or box about the origin with its axis along z, by the half
    extents of its bounding box [m].
    """
    x, y, z = half
    if kind == "box":
        corners = np.array([[i, j, k] for i in (-x, x) for j in (-y, y) for k in (-z, z)])
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
        return Mesh(corners, np.array(faces), color, flat=True)
    if kind == "cylinder":  # each edge twice, so that it stays sharp
        return revolved(np.array([(0, -z), (x, -z), (x, -z), (x, z), (x, z), (0, z)]), color)
    bow = np.linspace(-np.pi / 2, np.pi / 2, 16)
    ends = np.sign(bow) * max(z - x, 0.0)
    return revolved(np.stack([x * np.cos(bow), x * np.sin(bow) + ends], axis=1), color)


def _of_hand(part: Box | Capsule, color: Color) -> Mesh:
    if isinstance(part, Box):
        size = np.array(part.size) / 2
        return solid("box", tuple(size.tolist()), color).moved(np.array(part.center))
    way = np.subtract(part.end, part.start)
    length = float(np.linalg.norm(way))
    half = (part.radius, part.radius, part.radius + length / 2)
    turn = Rotation.align_vectors([way], [[0, 0, 1]])[0] if length else None
    return solid("capsule", half, color).moved(np.add(part.start, part.end) / 2, turn)


def hand_meshes(geometry: Geometry) -> Iterator[tuple[str, Mesh]]:
    """Every mesh of a hand, with the link in whose frame it is."""
    for part in geometry.palm_solids:
        yield "palm", _of_hand(part, COLORS["palm" if isinstance(part, Box) else "housing"])
    for digit in geometry.digits:
        for phalanx in digit.phalanges:
            radius = phalanx.capsule.radius
            side = (0.0, 0.75 * radius, 0.0)
            hinge = Capsule(tuple(-value for value in side), side, 0.5 * radius)
            yield phalanx.link, _of_hand(phalanx.capsule, COLORS["phalanx"])
            yield phalanx.link, _of_hand(hinge, COLORS["hinge"])
        tip = (1.003 * radius,) * 3
        pad = solid("sphere", tip, COLORS["pad"]).moved(np.array(phalanx.capsule.end))
        yield phalanx.link, pad


def object_meshes(spec: ObjectSpec) -> Iterator[Mesh]:
    """The solids of an object, in its frame."""
    if spec.model is None:
        yield solid(spec.shape, spec.half_extents, OBJECT_COLORS[spec.shape])
        return
    for part in spec.model.solids:
        if part.hull is not None:
            whole = Mesh(part.hull.vertices, part.hull.faces, spec.model.color, flat=True)
        else:
            half = tuple((np.array(part.size) / 2).tolist())
            whole = solid(part.kind, half, spec.model.color)
        moved = whole.moved(part.center, Rotation.from_matrix(part.rotation))
        yield Mesh(spec.scale * moved.vertices, moved.faces, moved.color, moved.flat)
