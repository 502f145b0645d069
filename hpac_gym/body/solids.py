"""Convex solids of uniform density: primitives and hulls, with their bounds and inertia."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model.checks import Array


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
