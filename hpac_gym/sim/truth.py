"""What only a simulation can measure: for critics, figures and tests, never for a policy that shall run on the real hand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pybullet

from hpac_gym.model.checks import Array
from hpac_gym.sim.scene import Scene


@dataclass(frozen=True, slots=True)
class Contacts:
    """Where the hand touches the object, in the world."""

    point: Array
    """On the object, shape (n, 3) [m]."""
    normal: Array
    """Unit vectors into the object, shape (n, 3)."""
    friction: float
    """Coulomb coefficient between skin and object."""


def contacts(scene: Scene) -> Contacts:
    """The contacts between hand and object."""
    found = pybullet.getContactPoints(scene.hand.body, scene.object.body, physicsClientId=scene.world.client)
    touching = [contact for contact in found if contact[8] <= 0]
    return Contacts(
        np.array([contact[6] for contact in touching]).reshape(-1, 3),
        -np.array([contact[7] for contact in touching]).reshape(-1, 3),
        scene.hand.settings.contact_friction * scene.object.spec.friction,
    )


def object_velocity(scene: Scene) -> tuple[Array, Array]:
    """Linear, shape (3,) [m/s], and angular, shape (3,) [rad/s], velocity of the object against the world.

    Along the axes of the hand frame.
    """
    linear, angular = pybullet.getBaseVelocity(scene.object.body, physicsClientId=scene.world.client)
    return scene.hand_rotation.T @ linear, scene.hand_rotation.T @ angular


def hand_from_world(scene: Scene, position: Array) -> Array:
    """A point of the world, shape (3,) [m], in the frame of the hand."""
    return scene.hand_rotation.T @ (position - scene.palm_position)


def tilt(scene: Scene) -> float:
    """Angle between the object's z axis and the vertical [rad]."""
    up = scene.hand_rotation[2] @ scene.object_pose()[1][:, 2]
    return float(np.arccos(min(max(up, -1.0), 1.0)))
