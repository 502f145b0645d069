"""Free objects and fixed boxes as PyBullet bodies."""

from collections.abc import Sequence

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.body.object_models import ObjectModel
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.urdf import object_urdf_file
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import OBJECT_COLORS
from hpac_gym.physics.pybullet.world import World
from hpac_gym.physics.supports import SUPPORT_FRICTION

SPIN_DECAY = 6.0
"""Spin damping rate of a named object [1/s]. The direct solver has no torsional friction at a
fingertip: without this, an object held by two fingertips would swing for ever."""


class SimObject:
    """One free body of an `ObjectSpec` in a `World`.

    Args:
        world: PyBullet world.
        spec: description of the object.
        position: position of its centre in the world, shape (3,) [m].
        orientation: quaternion xyzw, shape (4,).
        fixed: make the body static.
    """

    def __init__(
        self,
        world: World,
        spec: ObjectSpec,
        position: ArrayLike,
        orientation: ArrayLike = (0, 0, 0, 1),
        fixed: bool = False,
    ) -> None:
        self.spec = spec
        self._world = world
        self._client = world.client
        place = list(position), list(orientation)
        self.body = (
            self._primitive(*place) if spec.model is None else self._model(spec.model, *place)
        )
        pybullet.changeDynamics(
            self.body,
            -1,
            lateralFriction=spec.friction,
            linearDamping=0,
            angularDamping=0,
            physicsClientId=self._client,
        )
        if fixed:
            pybullet.changeDynamics(self.body, -1, mass=0.0, physicsClientId=self._client)

    def _primitive(self, position: list[float], orientation: list[float]) -> int:
        self._to_frame: tuple[Array, Array] | None = None
        spec = self.spec
        client = self._client
        kind, lengths = _form(spec, "height")
        solid = pybullet.createCollisionShape(kind, **lengths, physicsClientId=client)
        # A body without a visual shape gets one, which takes longest if it is round.
        kind, lengths = (
            _form(spec, "length")
            if self._world.visuals
            else (pybullet.GEOM_BOX, {"halfExtents": spec.half_extents})
        )
        visual = pybullet.createVisualShape(
            kind, **lengths, rgbaColor=OBJECT_COLORS[spec.shape], physicsClientId=client
        )
        return pybullet.createMultiBody(
            spec.mass, solid, visual, position, orientation, physicsClientId=client
        )

    def _model(self, model: ObjectModel, position: list[float], orientation: list[float]) -> int:
        # Without the second flag a cylinder becomes a faceted hull that keeps 1 mm distance from
        # the hand.
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER
        spec = self.spec
        body = pybullet.loadURDF(
            str(object_urdf_file(model)),
            position,
            orientation,
            globalScaling=spec.scale,
            flags=flags if self._world.visuals else flags | pybullet.URDF_IGNORE_VISUAL_SHAPES,
            physicsClientId=self._client,
        )
        mass, _, inertia, middle, turn, *_ = pybullet.getDynamicsInfo(body, -1, self._client)
        heavier = spec.mass / mass * spec.scale**2
        pybullet.changeDynamics(
            body,
            -1,
            mass=spec.mass,
            localInertiaDiagonal=[heavier * moment for moment in inertia],
            physicsClientId=self._client,
        )
        # PyBullet reports the pose of the principal inertia axes; this transform leads from there
        # to the object's frame.
        self._to_frame = pybullet.invertTransform(middle, turn)
        return body

    def lose_spin(self, dt: float) -> None:
        """Damp a named object's spin, once per physics step; PyBullet's own damping does not act on
        its base.
        """
        _, spin = pybullet.getBaseVelocity(self.body, self._client)
        kept = 1.0 - SPIN_DECAY * dt
        pybullet.resetBaseVelocity(
            self.body,
            angularVelocity=[kept * rate for rate in spin],
            physicsClientId=self._client,
        )

    def push(self, force: list[float]) -> None:
        """Apply a force [N], along the world's axes, at the centre of mass in the next physics
        step.
        """
        # Of mass, whatever the object's frame is.
        centre, _ = pybullet.getBasePositionAndOrientation(self.body, self._client)
        pybullet.applyExternalForce(
            self.body, -1, force, centre, pybullet.WORLD_FRAME, physicsClientId=self._client
        )

    def pose(self) -> tuple[Array, Sequence[float]]:
        """Centre, shape (3,) [m], and orientation, quaternion xyzw, in the world."""
        position, orientation = pybullet.getBasePositionAndOrientation(self.body, self._client)
        if self._to_frame is not None:
            position, orientation = pybullet.multiplyTransforms(
                position, orientation, *self._to_frame
            )
        return np.array(position), orientation

    def velocity(self) -> tuple[Sequence[float], Sequence[float]]:
        """Velocity of the centre [m/s] and spin [rad/s], along the world's axes."""
        velocity, spin = pybullet.getBaseVelocity(self.body, self._client)
        if self._to_frame is not None:  # PyBullet reports the velocity of the centre of mass
            of_mass, _ = pybullet.getBasePositionAndOrientation(self.body, self._client)
            velocity = velocity + np.cross(spin, self.pose()[0] - of_mass)
        return velocity, spin


def add_fixed_box(
    world: World,
    half_extents: ArrayLike,
    position: ArrayLike,
    color: ArrayLike,
    orientation: ArrayLike = (0, 0, 0, 1),
) -> int:
    """Add a static box, such as a table, and return its body."""
    client = world.client
    box = {"halfExtents": list(half_extents)}
    visual = -1
    solid = pybullet.createCollisionShape(pybullet.GEOM_BOX, **box, physicsClientId=client)
    if world.visuals:
        visual = pybullet.createVisualShape(
            pybullet.GEOM_BOX, **box, rgbaColor=list(color), physicsClientId=client
        )
    body = pybullet.createMultiBody(
        0, solid, visual, list(position), list(orientation), physicsClientId=client
    )
    pybullet.changeDynamics(body, -1, lateralFriction=SUPPORT_FRICTION, physicsClientId=client)
    return body


def _form(spec: ObjectSpec, height: str) -> tuple[int, dict[str, object]]:
    """PyBullet's type and dimensions of a primitive; `height` is the name of a cylinder's length in
    the call.
    """
    radius, _, half_height = spec.half_extents
    return {
        "box": (pybullet.GEOM_BOX, {"halfExtents": spec.half_extents}),
        "sphere": (pybullet.GEOM_SPHERE, {"radius": radius}),
        "cylinder": (pybullet.GEOM_CYLINDER, {"radius": radius, height: 2 * half_height}),
    }[spec.shape]
