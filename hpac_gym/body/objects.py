"""Objects to grasp and their supports as data: rigid primitives, or the named objects of
`object_models`.
"""

from dataclasses import dataclass, replace
from math import inf
from typing import Literal

import numpy as np

from hpac_gym.body.object_models import ObjectModel, Solid, load_object_models
from hpac_gym.errors import ParameterError
from hpac_gym.settings import check_bounds, check_choice, setting

Shape = Literal["cylinder", "box", "sphere"]
SHAPES: tuple[Shape, ...] = ("cylinder", "box", "sphere")

GREY = (0.45, 0.52, 0.62, 1.0)
"""Colour of an object of one's own, RGBA."""
WALL_THICKNESS = 0.003
"""Thickness of a support's walls [m]."""


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """A primitive object, or a modelled object with the primitive that is nearest to it.

    Raises:
        ParameterError: An unknown shape or model, a size, mass, friction or scale that is not
            positive and finite, or a round shape with unequal radii.
    """

    shape: Shape
    half_extents: tuple[float, float, float] = setting(
        bounds=(0.0, inf), above=True, size=3, unit="m"
    )
    """Half-extents of the bounding box, 3 values [m]; a cylinder's axis is z."""
    mass: float = setting(bounds=(0.0, inf), above=True, number=True, unit="kg")
    """[kg]"""
    friction: float = setting(bounds=(0.0, inf), above=True, number=True)
    """Coulomb coefficient of its surface, to be multiplied by the hand's."""
    model: ObjectModel | str | None = None
    """Model that replaces the primitive; a name is looked up in `load_object_models`."""
    scale: float = setting(1.0, bounds=(0.0, inf), above=True)
    """Scale factor of the model."""

    def __post_init__(self) -> None:
        check_choice("shape", self.shape, SHAPES)
        if isinstance(self.half_extents, np.ndarray):
            object.__setattr__(self, "half_extents", tuple(self.half_extents.tolist()))
        check_bounds(self, "object")
        x, y, z = map(float, self.half_extents)
        object.__setattr__(self, "half_extents", (x, y, z))
        if (self.shape != "box" and x != y) or (self.shape == "sphere" and x != z):
            raise ParameterError(f"half extents {self.half_extents} m do not fit a {self.shape}")
        if self.model is not None and not isinstance(self.model, ObjectModel):
            check_choice("model", self.model, load_object_models())
            object.__setattr__(self, "model", load_object_models()[self.model])
        if self.model is not None and self.model.has_hulls and self.scale != 1:
            raise ParameterError(
                f"scale {self.scale:g} of {self.model.name}: an object of one's own has the scale 1 here"
            )

    @property
    def solid_model(self) -> ObjectModel:
        """The object as a model of its own size and mass; that of a primitive has one solid."""
        if self.model is None:
            x, y, z = (2 * half for half in self.half_extents)
            solid = Solid(self.shape, self.mass, (x, y, z), np.zeros(3), np.eye(3))
            name = f"own {self.shape}"
            return ObjectModel(name, name, (x, y, z), self.mass, self.shape, GREY, (solid,))
        heavier = self.mass / self.model.mass
        solids = tuple(solid.scaled(self.scale, heavier) for solid in self.model.solids)
        size = tuple(self.scale * side for side in self.model.size)
        return replace(self.model, mass=self.mass, size=size, solids=solids)


@dataclass(frozen=True, slots=True)
class Support:
    """A post under the object, with walls that retain an object that does not stand by itself.

    Lengths are along the world's axes, rotated by the object's yaw.

    Raises:
        ParameterError: A length that is not positive, or a place that is not finite.
    """

    half_width: tuple[float, float] = setting(bounds=(0.0, inf), above=True, size=2, unit="m")
    """Half-widths of the post along x and y [m]."""
    gap: tuple[float, float] | None = None
    """Half of the distance between opposite walls along x and y [m]; None or infinity for no walls.
    """
    wall_height: float = setting(0.02, bounds=(0.0, inf), above=True, unit="m")
    """Height of the walls above the post [m]."""
    spread: tuple[float, float] = setting((0.0, 0.0), bounds=(-inf, inf), size=2, unit="m")
    """Offset of two such posts to either side of the centre [m]; zero is a single post."""
    table_height: float = setting(0.0, bounds=(-inf, inf), unit="m")
    """Height of the table in the world [m]; the wrist starts at 0.25 m."""

    def __post_init__(self) -> None:
        check_bounds(self, "support")
        if self.gap is not None and not (len(self.gap) == 2 and all(side > 0 for side in self.gap)):
            raise ParameterError(f"support gap = {self.gap} m must be 2 values greater than 0 m")

    def boxes(
        self, height: float
    ) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
        """Half-extents and centre of every box [m], relative to the point of the table below the
        object.

        Args:
            height: height of the object's underside above the table [m].
        """
        (x, y) = self.half_width
        (gap_x, gap_y) = self.gap or (np.inf, np.inf)
        tall = height + self.wall_height
        half = WALL_THICKNESS / 2
        walls = []
        for sign in (-1, 1) if any(self.spread) else (1,):
            across, along = (sign * way for way in self.spread)
            walls.append(((x, y, height / 2), (across, along, height / 2)))
            for side in (-1, 1):
                if np.isfinite(gap_x):
                    walls.append(
                        ((half, y, tall / 2), (across + side * (gap_x + half), along, tall / 2))
                    )
                if np.isfinite(gap_y):
                    walls.append(
                        ((x, half, tall / 2), (across, along + side * (gap_y + half), tall / 2))
                    )
        return walls
