"""What the hand grasps, and what it stands on: rigid primitives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.model.checks import Array
from hpac_gym.sim.world import World

Shape = Literal["cylinder", "box", "sphere"]
SHAPES: tuple[Shape, ...] = ("cylinder", "box", "sphere")

_COLORS = {"cylinder": (0.16, 0.50, 0.73, 1.0), "box": (0.80, 0.33, 0.23, 1.0), "sphere": (0.30, 0.62, 0.35, 1.0)}


@dataclass(frozen=True, slots=True)
class ObjectSpec:
    """A primitive object.

    Raises:
        ValueError: An unknown shape, a size, mass or friction that is not positive, or a round shape with unequal radii.
    """

    shape: Shape
    half_extents: tuple[float, float, float]
    """Half of the bounding box [m]; a cylinder's axis is z."""
    mass: float
    """[kg]"""
    friction: float
    """Coulomb coefficient of its surface; PyBullet multiplies it with the hand's."""

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ValueError(f"shape {self.shape!r} is none of {', '.join(SHAPES)}")
        if not (min(self.half_extents) > 0 and self.mass > 0 and self.friction > 0):
            raise ValueError(f"half extents, mass and friction of {self} must be positive")
        x, y, z = self.half_extents
        if (self.shape != "box" and x != y) or (self.shape == "sphere" and x != z):
            raise ValueError(f"half extents {self.half_extents} m do not fit a {self.shape}")


class SimObject:
    """One free body of an `ObjectSpec` in a `World`."""

    def __init__(self, world: World, spec: ObjectSpec, position: ArrayLike, orientation: ArrayLike = (0, 0, 0, 1)) -> None:
        self.spec, self._client = spec, world.client
        self.body = pybullet.createMultiBody(
            spec.mass,
            _collision_shape(spec, self._client),
            _visual_shape(spec, self._client),
            list(position),
            list(orientation),
            physicsClientId=self._client,
        )
        pybullet.changeDynamics(
            self.body, -1, lateralFriction=spec.friction, linearDamping=0, angularDamping=0, physicsClientId=self._client
        )

    def pose(self) -> tuple[Array, Array]:
        """Centre, shape (3,) [m], and orientation, quaternion xyzw, shape (4,), in the world."""
        position, orientation = pybullet.getBasePositionAndOrientation(self.body, self._client)
        return np.array(position), np.array(orientation)


def add_fixed_box(world: World, half_extents: ArrayLike, position: ArrayLike, color: ArrayLike, friction: float) -> int:
    """A box that never moves, such as a table. Returns its body."""
    size = list(half_extents)
    body = pybullet.createMultiBody(
        0,
        pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=size, physicsClientId=world.client),
        pybullet.createVisualShape(pybullet.GEOM_BOX, halfExtents=size, rgbaColor=list(color), physicsClientId=world.client),
        list(position),
        physicsClientId=world.client,
    )
    pybullet.changeDynamics(body, -1, lateralFriction=friction, physicsClientId=world.client)
    return body


def _collision_shape(spec: ObjectSpec, client: int) -> int:
    radius, _, half_height = spec.half_extents
    if spec.shape == "box":
        return pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=spec.half_extents, physicsClientId=client)
    if spec.shape == "sphere":
        return pybullet.createCollisionShape(pybullet.GEOM_SPHERE, radius=radius, physicsClientId=client)
    return pybullet.createCollisionShape(
        pybullet.GEOM_CYLINDER, radius=radius, height=2 * half_height, physicsClientId=client
    )


def _visual_shape(spec: ObjectSpec, client: int) -> int:
    radius, _, half_height = spec.half_extents
    color = _COLORS[spec.shape]
    if spec.shape == "box":
        return pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=spec.half_extents, rgbaColor=color, physicsClientId=client
        )
    if spec.shape == "sphere":
        return pybullet.createVisualShape(pybullet.GEOM_SPHERE, radius=radius, rgbaColor=color, physicsClientId=client)
    return pybullet.createVisualShape(
        pybullet.GEOM_CYLINDER, radius=radius, length=2 * half_height, rgbaColor=color, physicsClientId=client
    )
