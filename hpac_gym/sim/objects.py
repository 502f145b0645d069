"""What the hand grasps, and what it stands on: rigid primitives, or the objects of `assets/urdf/objects`."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.model.checks import Array
from hpac_gym.sim.assets import asset_path
from hpac_gym.sim.world import World

Shape = Literal["cylinder", "box", "sphere"]
SHAPES: tuple[Shape, ...] = ("cylinder", "box", "sphere")

SPIN_DECAY = 6.0
"""Rate at which a named object loses its spin [1/s]. The direct solver knows no friction against twisting on a fingertip:
without this, what two fingertips hold would swing for ever."""

WALL_THICKNESS = 0.003
"""Of a support's walls [m]."""

_COLORS = {"cylinder": (0.16, 0.50, 0.73, 1.0), "box": (0.80, 0.33, 0.23, 1.0), "sphere": (0.30, 0.62, 0.35, 1.0)}


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
    model: str | None = None
    """Name of an object of `assets/urdf/objects` that takes the primitive's place."""
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


class SimObject:
    """One free body of an `ObjectSpec` in a `World`.

    Args:
        world: where it lives.
        spec: what it is.
        position: of its centre, shape (3,) [m].
        orientation: quaternion xyzw, shape (4,).
        visuals: load what only a camera sees.
    """

    def __init__(
        self,
        world: World,
        spec: ObjectSpec,
        position: ArrayLike,
        orientation: ArrayLike = (0, 0, 0, 1),
        visuals: bool = True,
    ) -> None:
        self.spec, self._client = spec, world.client
        place = list(position), list(orientation)
        self.body = self._primitive(*place, visuals) if spec.model is None else self._model(spec.model, *place, visuals)
        pybullet.changeDynamics(
            self.body, -1, lateralFriction=spec.friction, linearDamping=0, angularDamping=0, physicsClientId=self._client
        )

    def _primitive(self, position: list[float], orientation: list[float], visuals: bool) -> int:
        self._to_frame: tuple[Array, Array] | None = None
        return pybullet.createMultiBody(
            self.spec.mass,
            _collision_shape(self.spec, self._client),
            _visual_shape(self.spec, self._client) if visuals else -1,
            position,
            orientation,
            physicsClientId=self._client,
        )

    def _model(self, name: str, position: list[float], orientation: list[float], visuals: bool) -> int:
        # Without the second flag a cylinder becomes a hull of flat faces that stands 1 mm off the hand.
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER
        spec = self.spec
        body = pybullet.loadURDF(
            str(asset_path(f"objects/{name}.urdf")), position, orientation, globalScaling=spec.scale,
            flags=flags if visuals else flags | pybullet.URDF_IGNORE_VISUAL_SHAPES, physicsClientId=self._client,
        )  # fmt: skip
        mass, _, inertia, middle, turn, *_ = pybullet.getDynamicsInfo(body, -1, self._client)
        heavier = spec.mass / mass * spec.scale**2
        pybullet.changeDynamics(
            body, -1, mass=spec.mass, localInertiaDiagonal=[heavier * moment for moment in inertia], physicsClientId=self._client
        )
        # PyBullet reports the pose of the principal axes of inertia: this leads from there to the object's frame.
        self._to_frame = pybullet.invertTransform(middle, turn)
        return body

    def lose_spin(self, dt: float) -> None:
        """Slow a named object's rotation, once every physics step; PyBullet's own damping does not act on its base."""
        if self.spec.model is not None:
            _, spin = pybullet.getBaseVelocity(self.body, self._client)
            kept = 1.0 - SPIN_DECAY * dt
            pybullet.resetBaseVelocity(
                self.body, angularVelocity=[kept * rate for rate in spin], physicsClientId=self._client
            )

    def pose(self) -> tuple[Array, Array]:
        """Centre, shape (3,) [m], and orientation, quaternion xyzw, shape (4,), in the world."""
        position, orientation = pybullet.getBasePositionAndOrientation(self.body, self._client)
        if self._to_frame is not None:
            position, orientation = pybullet.multiplyTransforms(position, orientation, *self._to_frame)
        return np.array(position), np.array(orientation)


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


def add_fixed_box(
    world: World,
    half_extents: ArrayLike,
    position: ArrayLike,
    color: ArrayLike | None,
    friction: float,
    orientation: ArrayLike = (0, 0, 0, 1),
) -> int:
    """A box that never moves, such as a table; without a colour no camera sees it. Returns its body."""
    size, visual = list(half_extents), -1
    if color is not None:
        visual = pybullet.createVisualShape(
            pybullet.GEOM_BOX, halfExtents=size, rgbaColor=list(color), physicsClientId=world.client
        )
    body = pybullet.createMultiBody(
        0,
        pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=size, physicsClientId=world.client),
        visual,
        list(position),
        list(orientation),
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
