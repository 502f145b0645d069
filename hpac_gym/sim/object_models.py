"""What the objects of the named grasps are made of: real measures and the solids that stand for them, as data.

Nothing here knows a simulator. The numbers and their sources are in ``data/objects.toml``.
"""

from __future__ import annotations

import itertools
import math
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.sim.geometry import rotation_about

MODELS_FILE = Path(__file__).parent / "data" / "objects.toml"
STAVES = 16
"""Flat pieces that a ring is made of."""

_AXES = {"x": rotation_about((0, 1, 0), math.pi / 2), "y": rotation_about((1, 0, 0), -math.pi / 2), "z": np.eye(3)}
_FIELDS = {"about", "source", "size", "mass", "shape", "color", "solids"}


@dataclass(frozen=True, slots=True)
class Solid:
    """A primitive body of one density; round ones have their axis along their own z."""

    kind: Literal["box", "cylinder", "sphere", "capsule"]
    mass: float
    """[kg]"""
    size: tuple[float, float, float]
    """Of the box around it, along its own axes; a capsule's includes its round ends [m]."""
    center: Array
    """Shape (3,) [m]."""
    rotation: Array
    """From its own axes to the object's, shape (3, 3)."""
    inner_radius: float = 0.0
    """Of the hollow of a cylinder or sphere; only its inertia shows it [m]."""

    @property
    def radius(self) -> float:
        """Of a round solid [m]."""
        return self.size[0] / 2

    @property
    def inertia(self) -> Array:
        """About its own centre, in the object's axes, shape (3, 3) [kg m²]."""
        return self.rotation @ np.diag(_principal_inertia(self)) @ self.rotation.T

    @property
    def reach(self) -> Array:
        """Half of its extent along each of the object's axes, shape (3,) [m]."""
        half = np.array(self.size) / 2
        if self.kind == "box":
            return np.abs(self.rotation) @ half
        if self.kind == "sphere":
            return half
        along = np.abs(self.rotation[:, 2])
        if self.kind == "capsule":
            return (half[2] - half[0]) * along + half[0]
        return half[2] * along + half[0] * np.sqrt(np.maximum(1 - along**2, 0.0))


@dataclass(frozen=True, slots=True)
class ObjectModel:
    """One object: the measures of the real thing, and the solids that stand for it.

    Raises:
        ParameterError: The solids' masses do not add up to the object's, or their middle is not the origin.
    """

    name: str
    about: str
    source: str
    size: tuple[float, float, float]
    """Of the real thing [m]."""
    mass: float
    """Of the real thing [kg]."""
    shape: str
    """The nearest primitive: cylinder, box or sphere."""
    color: tuple[float, ...]
    solids: tuple[Solid, ...]

    def __post_init__(self) -> None:
        total = sum(solid.mass for solid in self.solids)
        if not math.isclose(total, self.mass, rel_tol=1e-6):
            raise ParameterError(f"solids of {self.name} weigh {total:.6g} kg, the object {self.mass:.6g} kg")
        low, high = self.bounds
        if np.abs(low + high).max() > 2e-4:
            raise ParameterError(f"solids of {self.name} have their middle at {(low + high) / 2} m, not at the origin")

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper corner of the solids' bounding box, shapes (3,) [m]."""
        low = np.min([solid.center - solid.reach for solid in self.solids], axis=0)
        return low, np.max([solid.center + solid.reach for solid in self.solids], axis=0)

    @property
    def half_extents(self) -> tuple[float, float, float]:
        """Half of the real thing's size; of a round thing its radius along both axes [m]."""
        x, y, z = (side / 2 for side in self.size)
        return x, y, z

    @property
    def center_of_mass(self) -> Array:
        """Shape (3,) [m]."""
        return sum(solid.mass * solid.center for solid in self.solids) / self.mass

    @property
    def inertia(self) -> Array:
        """About the centre of mass, shape (3, 3) [kg m²]."""
        total = np.zeros((3, 3))
        for solid in self.solids:
            offset = solid.center - self.center_of_mass
            total += solid.inertia + solid.mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
        return total


def load_object_models(path: Path = MODELS_FILE) -> dict[str, ObjectModel]:
    """Every object by its name.

    Raises:
        ParameterError: A field is missing or unknown, or an object does not add up.
    """
    table = tomllib.loads(path.read_text(encoding="utf-8"))
    return {name: _model(name, entry) for name, entry in table.items()}


def _model(name: str, entry: dict[str, Any]) -> ObjectModel:
    if set(entry) != _FIELDS:
        raise ParameterError(f"object {name}: fields {', '.join(sorted(set(entry) ^ _FIELDS))} are missing or unknown")
    try:
        solids = tuple(part for solid in entry["solids"] for part in _parts(dict(solid)))
    except (KeyError, TypeError, ValueError) as error:
        raise ParameterError(f"object {name}: bad solid: {error}") from None
    plain = {key: entry[key] for key in ("about", "source", "mass", "shape")}
    return ObjectModel(name, size=tuple(entry["size"]), color=tuple(entry["color"]), solids=solids, **plain)


def _parts(solid: dict[str, Any]) -> Iterator[Solid]:
    kind, mass = solid["kind"], solid["mass"]
    center, axis = np.array(solid.get("center", (0.0, 0.0, 0.0))), _AXES[solid.get("axis", "z")]
    if kind == "box":
        yield Solid("box", mass, tuple(solid["size"]), center, rotation_about((0, 0, 1), solid.get("turn", 0.0)))
    elif kind == "ring":
        yield from _ring(solid, center, axis)
    elif kind in ("cylinder", "sphere", "capsule"):
        width = 2 * solid["radius"]
        length = width if kind == "sphere" else solid["length"]
        yield Solid(kind, mass, (width, width, length), center, axis, solid.get("inner_radius", 0.0))
    else:
        raise ValueError(f"kind {kind!r} is none of box, cylinder, sphere, capsule, ring")


def _ring(solid: dict[str, Any], center: Array, axis: Array) -> Iterator[Solid]:
    """Staves around an axis; their middles lie on the circle between both radii, stretched along the ring's own y."""
    outer, inner, stretch = solid["radius"], solid["inner_radius"], solid.get("stretch", 1.0)
    wall, middle = outer - inner, (outer + inner) / 2
    across, along = middle, outer * stretch - wall / 2
    corners = [_on_ellipse(across, along, (index - 0.5) * 2 * math.pi / STAVES) for index in range(STAVES + 1)]
    for start, end in itertools.pairwise(corners):
        chord = end - start
        turn = rotation_about((0, 0, 1), math.atan2(chord[1], chord[0]))
        size = (float(np.linalg.norm(chord)) * outer / middle, wall, solid["length"])  # their outer edges meet
        yield Solid("box", solid["mass"] / STAVES, size, center + axis @ ((start + end) / 2), axis @ turn)


def _on_ellipse(across: float, along: float, angle: float) -> Array:
    # A chord's middle lies inside of its arc: this puts it on the ellipse.
    widen = 1 / math.cos(math.pi / STAVES)
    return widen * np.array([across * math.cos(angle), along * math.sin(angle), 0.0])


def _principal_inertia(solid: Solid) -> list[float]:
    mass, (x, y, z), outer, inner = solid.mass, solid.size, solid.radius, solid.inner_radius
    if solid.kind == "box":
        return [mass / 12 * (y * y + z * z), mass / 12 * (x * x + z * z), mass / 12 * (x * x + y * y)]
    if solid.kind == "sphere":
        return [2 / 5 * mass * (outer**5 - inner**5) / (outer**3 - inner**3)] * 3
    if solid.kind == "cylinder":
        across = mass / 12 * (3 * (outer**2 + inner**2) + z * z)
        return [across, across, mass / 2 * (outer**2 + inner**2)]
    length = z - 2 * outer
    tube = mass * length / (length + 4 / 3 * outer)
    caps = mass - tube
    across = tube * (length**2 / 12 + outer**2 / 4) + caps * (2 / 5 * outer**2 + length**2 / 4 + 3 / 8 * length * outer)
    return [across, across, (tube / 2 + 2 / 5 * caps) * outer**2]
