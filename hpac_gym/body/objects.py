"""What the hand grasps and what that stands on, as data: rigid primitives, or the named objects of `object_models`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hpac_gym.body.object_models import ObjectModel, load_object_models

Shape = Literal["cylinder", "box", "sphere"]
SHAPES: tuple[Shape, ...] = ("cylinder", "box", "sphere")

WALL_THICKNESS = 0.003
"""Of a support's walls [m]."""


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """A primitive object, or a named one that is nearest to that primitive.

    Raises:
        ValueError: An unknown shape, a size, mass or friction that is not positive and finite, or a round shape with
            unequal radii.
    """

    shape: Shape
    half_extents: tuple[float, float, float]
    """Half of the bounding box [m]; a cylinder's axis is z."""
    mass: float
    """[kg]"""
    friction: float
    """Coulomb coefficient of its surface; PyBullet multiplies it with the hand's."""
    model: ObjectModel | str | None = None
    """An object of solids that takes the primitive's place. The name of one of `load_object_models` becomes that object."""
    scale: float = 1.0
    """Size of that object, its own being 1."""

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ValueError(f"shape {self.shape!r} is none of {', '.join(SHAPES)}")
        if not all(0 < value < math.inf for value in (*self.half_extents, self.mass, self.friction, self.scale)):
            raise ValueError(f"half extents, mass, friction and scale of {self} must be positive and finite")
        x, y, z = self.half_extents
        if (self.shape != "box" and x != y) or (self.shape == "sphere" and x != z):
            raise ValueError(f"half extents {self.half_extents} m do not fit a {self.shape}")
        if isinstance(self.model, str):
            if self.model not in load_object_models():
                raise ValueError(f"model {self.model!r} is none of {', '.join(load_object_models())}")
            object.__setattr__(self, "model", load_object_models()[self.model])
        if self.model is not None and self.model.has_hulls and self.scale != 1:
            raise ValueError(f"scale {self.scale:g} of {self.model.name}: an object of one's own has the scale 1 here")


@dataclass(frozen=True, slots=True)
class Support:
    """A post under the object, with walls that keep what does not stand by itself.

    Lengths are along the world's axes, turned with the object by its yaw.

    Raises:
        ValueError: A length that is not positive.
    """

    half_width: tuple[float, float]
    """Of the post [m]."""
    offset: tuple[float, float] = (0.0, 0.0)
    """Of the post's middle from below the object's centre [m]."""
    gap: tuple[float, float] | None = None
    """Half of the distance between the walls on either side; infinite for none [m]."""
    wall_height: float = 0.02
    """Above the post [m]."""
    spread: tuple[float, float] = (0.0, 0.0)
    """From the middle to either one of two such posts; zero is one post [m]."""
    table_height: float = 0.0
    """Of the table below it in the world; the wrist starts at 0.25 [m]."""

    def __post_init__(self) -> None:
        if not min(*self.half_width, *(self.gap or ()), self.wall_height) > 0:
            raise ValueError(f"lengths of {self} must be greater than 0 m")

    def boxes(self, height: float) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
        """Half extents and centre of every box, [m], relative to the point of the table below the object.

        Args:
            height: of the object's underside above the table [m].
        """
        (x, y), (gap_x, gap_y) = self.half_width, self.gap or (np.inf, np.inf)
        tall, half, found = height + self.wall_height, WALL_THICKNESS / 2, []
        for across, along in {(sign * self.spread[0], sign * self.spread[1]): None for sign in (-1, 1)}:
            across, along = across + self.offset[0], along + self.offset[1]
            found.append(((x, y, height / 2), (across, along, height / 2)))
            for side in (-1, 1):
                if np.isfinite(gap_x):
                    found.append(((half, y, tall / 2), (across + side * (gap_x + half), along, tall / 2)))
                if np.isfinite(gap_y):
                    found.append(((x, half, tall / 2), (across, along + side * (gap_y + half), tall / 2)))
        return found
