"""The solids of hand, object and supports as triangles [m]. The page shades smoothly, so that sharp
edges have vertices of their own on either side."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from trimesh import Trimesh, creation

from hpac_gym.body.geometry import Box, Capsule, Geometry
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.urdf import COLORS
from hpac_gym.physics.engine import OBJECT_COLORS

AROUND = 28
"""Corners of a circle."""
Color = tuple[float, ...]
"""RGB or RGBA, each in [0, 1]."""


def moved(mesh: Trimesh, place: ArrayLike, turn: Rotation | None = None) -> Trimesh:
    """The mesh, which is turned, and moved by a way, shape (3,) [m]."""
    turned = mesh.vertices if turn is None else turn.apply(mesh.vertices)
    mesh.vertices = turned + place
    return mesh


def solid(kind: str, half: ArrayLike) -> Trimesh:
    """A sphere, capsule, cylinder or box about the origin with its axis along z, by the half
    extents of its bounding box, shape (3,) [m].
    """
    x, _, z = half
    if kind == "box":
        box = creation.box(2 * np.asarray(half))
        box.unmerge_vertices()
        return box
    if kind == "cylinder":
        profile = np.array([(0, -z), (x, -z), (x, -z), (x, z), (x, z), (0, z)])
    else:
        bow = np.linspace(-np.pi / 2, np.pi / 2, 16)
        ends = np.sign(bow) * max(z - x, 0.0)
        profile = np.stack([x * np.cos(bow), x * np.sin(bow) + ends], axis=1)
    # In mm: trimesh leaves out triangles smaller than 1e-8.
    return creation.revolve(1e3 * profile, sections=AROUND, process=False).apply_scale(1e-3)


def _of_hand(part: Box | Capsule) -> Trimesh:
    if isinstance(part, Box):
        return moved(solid("box", np.array(part.size) / 2), part.center)
    way = np.subtract(part.end, part.start)
    length = float(np.linalg.norm(way))
    half = (part.radius, part.radius, part.radius + length / 2)
    turn = Rotation.align_vectors([way], [[0, 0, 1]])[0] if length else None
    return moved(solid("capsule", half), np.add(part.start, part.end) / 2, turn)


def hand_meshes(geometry: Geometry) -> Iterator[tuple[str, Trimesh, Color]]:
    """Every mesh of a hand with its colour, and the link in whose frame it is."""
    for part in geometry.palm_solids:
        yield "palm", _of_hand(part), COLORS["palm" if isinstance(part, Box) else "housing"]
    for digit in geometry.digits:
        for phalanx in digit.phalanges:
            radius = phalanx.capsule.radius
            side = (0.0, 0.75 * radius, 0.0)
            hinge = Capsule(tuple(-value for value in side), side, 0.5 * radius)
            yield phalanx.link, _of_hand(phalanx.capsule), COLORS["phalanx"]
            yield phalanx.link, _of_hand(hinge), COLORS["hinge"]
        pad = solid("sphere", (1.003 * radius,) * 3)
        yield phalanx.link, moved(pad, phalanx.capsule.end), COLORS["pad"]


def object_meshes(spec: ObjectSpec) -> Iterator[tuple[Trimesh, Color]]:
    """The solids of an object in its frame, with their colour."""
    if spec.model is None:
        yield solid(spec.shape, spec.half_extents), OBJECT_COLORS[spec.shape]
        return
    for part in spec.model.solids:
        if part.hull is not None:
            mesh = Trimesh(part.hull.vertices, part.hull.faces, process=False)
            mesh.unmerge_vertices()
        else:
            mesh = solid(part.kind, np.array(part.size) / 2)
        mesh = moved(mesh, part.center, Rotation.from_matrix(part.rotation))
        yield mesh.apply_scale(spec.scale), spec.model.color
