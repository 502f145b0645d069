"""Models of objects: convex solids of uniform density, with their bounds and inertia, and the named
grasps' objects as data: dimensions of the real objects and the solids that approximate them.

Independent of any simulator. Real objects, their numbers and sources are in ``data/objects.toml``;
the fictitious objects that replace them in the held-out shape variants are in
``data/held_out_objects.toml``. The files are ours: tests check that their entries are complete and
add up."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.geometry import rotation_about, table_of
from hpac_gym.model.checks import Array

STAVES = 16
"""Default number of flat staves that make up a ring."""

_AXES = {
    "x": rotation_about((0, 1, 0), math.pi / 2),
    "y": rotation_about((1, 0, 0), -math.pi / 2),
    "z": np.eye(3),
}


@dataclass(frozen=True, slots=True, eq=False)
class Hull:
    """A convex polyhedron."""

    vertices: Array
    """Corners, shape (n, 3) [m]."""
    faces: NDArray[np.int_]
    """Corners of each triangle, counter-clockwise seen from outside, shape (m, 3)."""

    def moments(self) -> tuple[float, Array, Array]:
        """Volume [m³], centroid, shape (3,) [m], and ∫ r rᵀ dV about the origin, shape (3, 3)
        [m⁵].
        """
        corners = self.vertices[self.faces]
        # Six times the volume of the tetrahedron between a face and the origin.
        sixfold = np.linalg.det(corners)
        total = corners.sum(axis=1)
        volume = sixfold.sum() / 6
        centre = (sixfold[:, None] * total).sum(axis=0) / 24 / volume
        squares = np.einsum("fki,fkj->fij", corners, corners) + np.einsum(
            "fi,fj->fij", total, total
        )
        return float(volume), centre, (sixfold[:, None, None] * squares).sum(axis=0) / 120


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A convex solid of uniform density; the axis of a round solid is its own z axis."""

    kind: Literal["box", "cylinder", "sphere", "capsule", "hull"]
    mass: float
    """[kg]"""
    size: tuple[float, float, float]
    """Size of the bounding box along its own axes [m]; a capsule's includes the round ends."""
    center: Array
    """Centre of mass in the object's frame, shape (3,) [m]."""
    rotation: Array
    """Rotation from its own axes to the object's, shape (3, 3)."""
    inner_radius: float = 0.0
    """Inner radius of a hollow cylinder or sphere [m]; it affects the inertia only."""
    hull: Hull | None = None
    """Polyhedron of a hull, relative to its centre of mass; None for a primitive."""

    def moved(self, rotation: Array, place: Array | float = 0.0) -> Solid:
        """The solid rotated about the origin, then translated."""
        center = rotation @ self.center + place
        return replace(self, center=center, rotation=rotation @ self.rotation)

    def scaled(self, scale: float, heavier: float) -> Solid:
        """The solid with all lengths scaled about the origin, and its mass by another factor."""
        hull = self.hull
        if hull is not None:
            hull = Hull(scale * hull.vertices, hull.faces)
        return replace(
            self,
            mass=heavier * self.mass,
            size=tuple(scale * side for side in self.size),
            center=scale * self.center,
            inner_radius=scale * self.inner_radius,
            hull=hull,
        )

    @property
    def radius(self) -> float:
        """Radius of a round solid [m]."""
        return self.size[0] / 2

    @property
    def inertia(self) -> Array:
        """Inertia about its own centre of mass, in the object's axes, shape (3, 3) [kg·m²]."""
        if self.hull is not None:
            volume, _, squares = self.hull.moments()
            squares = self.rotation @ squares @ self.rotation.T * (self.mass / volume)
            return np.trace(squares) * np.eye(3) - squares
        moments = principal_inertia(self.kind, self.mass, self.size, self.inner_radius)
        return self.rotation @ np.diag(moments) @ self.rotation.T

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the bounding box along the object's axes, shapes (3,) [m]."""
        if self.hull is not None:
            corners = self.center + self.hull.vertices @ self.rotation.T
            return corners.min(axis=0), corners.max(axis=0)
        half = np.array(self.size) / 2
        along = np.abs(self.rotation[:, 2])
        match self.kind:
            case "box":
                reach = np.abs(self.rotation) @ half
            case "sphere":
                reach = half
            case "capsule":
                reach = (half[2] - half[0]) * along + half[0]
            case _:
                reach = half[2] * along + half[0] * np.sqrt(np.maximum(1 - along**2, 0.0))
        return self.center - reach, self.center + reach


def bounds_of(solids: Iterable[Solid]) -> tuple[Array, Array]:
    """Lower and upper corner of the bounding box of solids along the object's axes, shapes (3,)
    [m].
    """
    lows, highs = zip(*(solid.bounds for solid in solids), strict=True)
    return np.min(lows, axis=0), np.max(highs, axis=0)


def inertia_of_point(mass: float, place: Array) -> Array:
    """Inertia of a point mass [kg] at a place, shape (3,) [m], about the origin, shape (3, 3)
    [kg·m²].
    """
    return mass * (place @ place * np.eye(3) - np.outer(place, place))


def principal_inertia(
    kind: str, mass: float, size: tuple[float, float, float], inner: float = 0.0
) -> list[float]:
    """Principal moments of inertia of a primitive `Solid` about its own centre, from its fields, 3
    values [kg·m²].
    """
    x, y, z = size
    outer = x / 2
    if kind == "box":
        return [
            mass / 12 * (y * y + z * z),
            mass / 12 * (x * x + z * z),
            mass / 12 * (x * x + y * y),
        ]
    if kind == "sphere":
        return [2 / 5 * mass * (outer**5 - inner**5) / (outer**3 - inner**3)] * 3
    if kind == "cylinder":
        across = mass / 12 * (3 * (outer**2 + inner**2) + z * z)
        return [across, across, mass / 2 * (outer**2 + inner**2)]
    length = z - 2 * outer
    tube = mass * length / (length + 4 / 3 * outer)
    caps = mass - tube
    across = tube * (length**2 / 12 + outer**2 / 4) + caps * (
        2 / 5 * outer**2 + length**2 / 4 + 3 / 8 * length * outer
    )
    return [across, across, (tube / 2 + 2 / 5 * caps) * outer**2]


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """One object: dimensions of the real object, and the solids that approximate it, whose masses
    add up to the object's and whose bounding box is centred at the origin. Compared by identity.
    """

    name: str
    about: str
    size: tuple[float, float, float]
    """Size of the real object along x, y and z [m]."""
    mass: float
    """Mass of the real object [kg]."""
    shape: str
    """The nearest primitive: cylinder, box or sphere."""
    color: tuple[float, ...]
    solids: tuple[Solid, ...]

    def __repr__(self) -> str:
        """One line, without the solids."""
        sides = " × ".join(f"{side:g}" for side in self.size)
        return f"ObjectModel({self.name!r}, {sides} m, {self.mass:g} kg, {len(self.solids)} solids)"

    def turned_bounds(self, rotation: Array) -> tuple[Array, Array]:
        """Lower and upper corner of the bounding box of the solids after a rotation about the
        origin, shapes (3,) [m].

        Args:
            rotation: rotation from the object's axes to those of the box, shape (3, 3).
        """
        return bounds_of(solid.moved(rotation) for solid in self.solids)

    @property
    def has_hulls(self) -> bool:
        """True if any solid is a convex hull."""
        return any(solid.hull is not None for solid in self.solids)

    @property
    def half_extents(self) -> tuple[float, float, float]:
        """Half of the real object's size along x, y and z [m]."""
        x, y, z = (side / 2 for side in self.size)
        return x, y, z

    @cached_property
    def center_of_mass(self) -> Array:
        """Centre of mass in the object's frame, shape (3,) [m]."""
        return sum(solid.mass * solid.center for solid in self.solids) / self.mass

    @cached_property
    def inertia(self) -> Array:
        """Inertia about the centre of mass, in the object's axes, shape (3, 3) [kg·m²]."""
        total = np.zeros((3, 3))
        for solid in self.solids:
            offset = solid.center - self.center_of_mass
            total += solid.inertia + inertia_of_point(solid.mass, offset)
        return total


@cache
def load_object_models() -> Mapping[str, ObjectModel]:
    """Objects of the named grasps by name: the real ones, then the held-out ones. Every call
    returns the same objects.
    """
    entries = table_of("objects.toml") | table_of("held_out_objects.toml")
    return MappingProxyType({name: object_model(name, entry) for name, entry in entries.items()})


def object_model(name: str, entry: Mapping[str, Any]) -> ObjectModel:
    """Object described by an entry of an object file."""
    return ObjectModel(
        name,
        entry["about"],
        tuple(entry["size"]),
        entry["mass"],
        entry["shape"],
        tuple(entry["color"]),
        tuple(part for solid in entry["solids"] for part in solids_from(solid)),
    )


def solids_from(solid: Mapping[str, Any]) -> Iterator[Solid]:
    """Solids described by one entry of `solids` in an object file: a box, cylinder, sphere or
    capsule, or a ring, which yields several.
    """
    kind = solid["kind"]
    mass = solid["mass"]
    center = np.array(solid.get("center", (0.0, 0.0, 0.0)))
    axis = _AXES[solid.get("axis", "z")]
    if kind == "box":
        yield Solid(
            "box",
            mass,
            tuple(solid["size"]),
            center,
            rotation_about((0, 0, 1), solid.get("turn", 0.0)),
        )
    elif kind == "ring":
        yield from _ring(solid, center, axis)
    else:
        width = 2 * solid["radius"]
        length = width if kind == "sphere" else solid["length"]
        yield Solid(
            kind, mass, (width, width, length), center, axis, solid.get("inner_radius", 0.0)
        )


def _ring(solid: Mapping[str, Any], center: Array, axis: Array) -> Iterator[Solid]:
    """Staves of a ring; their centres lie on the circle midway between both radii, stretched along
    the ring's own y.

    Few staves can model a bar: six with a radius ratio of 1 : 0.268 have the inertia of a solid
    hexagonal bar."""
    outer = solid["radius"]
    inner = solid["inner_radius"]
    stretch = solid.get("stretch", 1.0)
    staves = solid.get("staves", STAVES)
    turned = rotation_about((0, 0, 1), solid.get("turn", 0.0))
    wall = outer - inner
    middle = (outer + inner) / 2
    # The midpoint of a chord lies inside its arc; this factor puts it on the ellipse.
    radii = np.array([middle, outer * stretch - wall / 2, 0.0]) / math.cos(math.pi / staves)
    angles = [(index - 0.5) * 2 * math.pi / staves for index in range(staves + 1)]
    corners = [turned @ (radii * (math.cos(angle), math.sin(angle), 0.0)) for angle in angles]
    for start, end in itertools.pairwise(corners):
        chord = end - start
        turn = rotation_about((0, 0, 1), math.atan2(chord[1], chord[0]))
        # So that the outer edges meet.
        size = (
            float(np.linalg.norm(chord)) * outer / middle,
            wall,
            solid["length"],
        )
        yield Solid(
            "box", solid["mass"] / staves, size, center + axis @ ((start + end) / 2), axis @ turn
        )
