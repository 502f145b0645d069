"""Models of the named grasps' objects as data: dimensions of the real objects and the solids that
approximate them.

Independent of any simulator. Real objects, their numbers and sources are in ``data/objects.toml``;
the fictitious objects that replace them in the held-out shape variants are in
``data/held_out_objects.toml``. The files are ours: tests check that their entries are complete and
add up."""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from types import MappingProxyType
from typing import Any

import numpy as np

from hpac_gym.body.geometry import rotation_about, table_of
from hpac_gym.body.solids import Solid, bounds_of, inertia_of_point
from hpac_gym.model.checks import Array

STAVES = 16
"""Default number of flat staves that make up a ring."""

_AXES = {
    "x": rotation_about((0, 1, 0), math.pi / 2),
    "y": rotation_about((1, 0, 0), -math.pi / 2),
    "z": np.eye(3),
}
FIELDS = {"about", "size", "mass", "shape", "color", "solids"}
"""Fields of an object in a file; a real one has `source`, `published` and `chosen` too, which tell
where its numbers are from.
"""


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
