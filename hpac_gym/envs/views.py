"""The three observations: what the real hand has, what only a critic may see, and a picture.

All of them hold the deployed vector of `hpac_gym.envs.observation`; "privileged" appends `PRIVILEGED_FIELDS` to it, "image"
sets an RGB picture beside it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol, get_args

import numpy as np
from gymnasium import Space, spaces
from numpy.typing import NDArray

from hpac_gym.envs.grip import Grip
from hpac_gym.envs.observation import AXES, GRASP_CENTRE, LENGTH_UNIT, Field, space_of, within
from hpac_gym.errors import ParameterError
from hpac_gym.model import DIGITS, JOINTS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.sim import Camera, Scene
from hpac_gym.sim.truth import object_velocity

Obs = Literal["deploy", "privileged", "image"]
Observation = NDArray[np.float32] | dict[str, NDArray]

IMAGE_SIZE = 84
"""Width and height of the picture [px]."""
FORCE_UNIT = 10.0
"""[N]"""
SPEED_UNIT = 10.0
"""Of joints and of the object's spin [rad/s]."""
PARTS = ("palm", *DIGITS)

PRIVILEGED_FIELDS = (
    Field("last_action", SERVOS, "1", -1.0, 1.0, "the last action; before the first one, where the hand stands"),
    Field("contact_force", PARTS, "10 N", 0.0, 10.0, "normal force between the object and a part of the hand"),
    Field("true_joint_pos", JOINTS, "rad", -0.5, 2.0, "true joint angle"),
    Field("true_joint_vel", JOINTS, "10 rad/s", -5.0, 5.0, "true joint speed"),
    Field("horn", SERVOS, "rad", 0.0, 2.0, "where the servo's horn is"),
    Field("tension", SERVOS[:-1], "10 N", 0.0, 10.0, "tension of the driving tendon"),
    Field("true_object_pos", AXES, "0.05 m", -4.0, 4.0, "true centre of the object in the hand frame, from `GRASP_CENTRE`"),
    Field("true_object_up", AXES, "1", -1.0, 1.0, "true z axis of the object in the hand frame"),
    Field("true_object_side", AXES, "1", -1.0, 1.0, "true x axis of the object in the hand frame"),
    Field("object_vel", AXES, "m/s", -5.0, 5.0, "velocity of the object against the world, along the axes of the hand frame"),
    Field("object_spin", AXES, "10 rad/s", -5.0, 5.0, "angular velocity of the object, along the axes of the hand frame"),
    Field("supported", ("touches",), "0/1", 0.0, 1.0, "whether the object touches what it stands on, or the table"),
    Field("hold_time", ("time",), "s", 0.0, 10.0, "for how long the hand has carried the object without a break"),
    Field("slip", ("distance",), "0.05 m", 0.0, 4.0, "how far the object's centre has moved in the hand since then"),
    Field("object_start", AXES, "0.05 m", -10.0, 10.0, "as `true_object_pos`, when the episode began"),
    Field("true_object_size", AXES, "0.05 m", 0.0, 4.0, "true half extents of the object along its own axes"),
    Field("object_mass", ("mass",), "kg", 0.0, 5.0, "true mass of the object"),
    Field("object_friction", ("friction",), "1", 0.0, 5.0, "true Coulomb coefficient between skin and object"),
    Field("joint_friction", ("friction",), "0.01 N·m", 0.0, 2.0, "Coulomb friction of every joint"),
    Field("tendon_stiffness", DIGITS, "1000 N", 0.0, 10.0, "EA of a digit's tendon"),
    Field("slack", DIGITS, "mm", 0.0, 3.0, "what a driving tendon has to wind up before it pulls"),
    Field("servo_lag", ("lag",), "0.1 s", 0.0, 2.0, "from a command to the servos' answer"),
    Field("dead_band", ("error",), "0.01 rad", 0.0, 10.0, "error that a servo leaves alone"),
)


@dataclass(frozen=True, slots=True)
class Moment:
    """What views are made of, beside the deployed vector."""

    scene: Scene
    forces: dict[str, float]
    """As `Scene.contact_forces` gives them."""
    grip: Grip
    last_action: Array
    """Shape (6,)."""


class View(Protocol):
    """Makes an observation of the deployed vector and the physics."""

    space: Space

    def see(self, deployed: NDArray[np.float32], moment: Moment) -> Observation:
        """The observation now."""
        ...


class Deployed:
    """The deployed vector and no more."""

    def __init__(self, fields: tuple[Field, ...], viewpoint: Camera) -> None:
        self.space = space_of(fields)

    def see(self, deployed: NDArray[np.float32], moment: Moment) -> NDArray[np.float32]:
        return deployed


class Privileged:
    """The deployed vector, then what only a simulation knows: for the critic of an actor that sees the first part."""

    def __init__(self, fields: tuple[Field, ...], viewpoint: Camera) -> None:
        self.space = space_of((*fields, *PRIVILEGED_FIELDS))
        self._truth = space_of(PRIVILEGED_FIELDS)

    def see(self, deployed: NDArray[np.float32], moment: Moment) -> NDArray[np.float32]:
        scene, grip = moment.scene, moment.grip
        hand, spec, settings = scene.hand, scene.object.spec, scene.hand.settings
        joint_pos, joint_vel = hand.joint_state()
        position, rotation = scene.object_pose()
        linear, angular = object_velocity(scene)
        truth = [
            moment.last_action,
            np.array([moment.forces.get(part, 0.0) for part in PARTS]) / FORCE_UNIT,
            joint_pos,
            joint_vel / SPEED_UNIT,
            hand.servos.horn,
            np.array(hand.tension) / FORCE_UNIT,
            (position - GRASP_CENTRE) / LENGTH_UNIT,
            rotation[:, 2],
            rotation[:, 0],
            linear,
            angular / SPEED_UNIT,
            [float(scene.on_support), grip.time, grip.slip / LENGTH_UNIT],
            (scene.setup.position - GRASP_CENTRE) / LENGTH_UNIT,
            np.array(spec.half_extents) / LENGTH_UNIT,
            [spec.mass, spec.friction * settings.contact_friction, settings.joint_friction / 0.01],
            [digit.tendon_stiffness / 1e3 for digit in hand.hand.digits.values()],
            [1e3 * slack for slack in settings.slack],
            [settings.servo.lag / 0.1, settings.servo.dead_band / 0.01],
        ]
        return np.concatenate([deployed, within(self._truth, np.concatenate(truth))])


class Image:
    """A picture beside the deployed vector. What a camera shows of the physics is not randomized."""

    def __init__(self, fields: tuple[Field, ...], viewpoint: Camera) -> None:
        picture = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        self.space = spaces.Dict({"deploy": space_of(fields), "image": picture})
        self._camera = replace(viewpoint, width=IMAGE_SIZE, height=IMAGE_SIZE)

    def see(self, deployed: NDArray[np.float32], moment: Moment) -> dict[str, NDArray]:
        return {"deploy": deployed, "image": self._camera.picture(moment.scene.world, view_target(moment.scene))}


VIEW_TARGET = np.array([0.03, 0.0, 0.10])
"""What pictures are centred on, in the hand frame [m]."""


def view_target(scene: Scene) -> Array:
    """What pictures are centred on now, in the world, shape (3,) [m]."""
    return scene.palm_position + scene.hand_rotation @ VIEW_TARGET


def known(obs: Obs) -> Obs:
    """The name, if it is one of a view.

    Raises:
        ParameterError: It is none.
    """
    if obs not in get_args(Obs):
        raise ParameterError(f"obs {obs!r} is none of {', '.join(get_args(Obs))}")
    return obs


def view(obs: Obs, fields: tuple[Field, ...], viewpoint: Camera) -> View:
    """The view of that name over a table of the deployed observation; pictures are taken from `viewpoint`.

    Raises:
        ParameterError: There is none.
    """
    return {"deploy": Deployed, "privileged": Privileged, "image": Image}[known(obs)](fields, viewpoint)
