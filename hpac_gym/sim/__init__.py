"""The physics of the hand in PyBullet: world, tendons, servos, hand, wrist and objects.

This package alone knows PyBullet. Importing it keeps PyBullet's greeting off standard output.
"""

from hpac_gym.sim.quiet import quiet_output

with quiet_output():
    import pybullet  # noqa: F401

from hpac_gym.sim.camera import Camera
from hpac_gym.sim.hand import HandSettings, SimHand
from hpac_gym.sim.object_models import ObjectModel, load_object_models
from hpac_gym.sim.objects import SHAPES, ObjectSpec, SimObject, Support
from hpac_gym.sim.scene import Scene, SceneSetup
from hpac_gym.sim.servos import Servos, ServoSettings
from hpac_gym.sim.stage import Stage
from hpac_gym.sim.tendons import Damping, Tendons
from hpac_gym.sim.world import World, WorldSettings
from hpac_gym.sim.wrist import Vector, Wrist

__all__ = [
    "SHAPES",
    "Camera",
    "Damping",
    "HandSettings",
    "ObjectModel",
    "ObjectSpec",
    "Scene",
    "SceneSetup",
    "ServoSettings",
    "Servos",
    "SimHand",
    "SimObject",
    "Stage",
    "Support",
    "Tendons",
    "Vector",
    "World",
    "WorldSettings",
    "Wrist",
    "load_object_models",
]
