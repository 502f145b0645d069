"""A grasp scene: the hand on its wrist, an object on a post, a table below. Physics only, no task."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import pybullet

from hpac_gym.model import HPAC, Hand, ServoCommand
from hpac_gym.model.checks import Array
from hpac_gym.sim.hand import HandSettings
from hpac_gym.sim.objects import ObjectSpec, SimObject, Support, add_fixed_box
from hpac_gym.sim.stage import Stage
from hpac_gym.sim.world import WorldSettings
from hpac_gym.sim.wrist import Vector, Wrist

HAND_POSITION = np.array([0.0, 0.0, 0.25])
"""Where the wrist starts in the world [m]."""
HAND_ROTATION = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Unless a setup says otherwise: fingers along the world's +x, palm facing +y, thumb up."""
HAND_QUATERNION = (0.5, 0.5, 0.5, 0.5)

POST_HALF_WIDTH = 0.012
TARGET_HALF_WIDTH = 0.05
_POST_FRICTION = 0.8
_GREY = (0.55, 0.55, 0.58, 1.0)
_GREEN = (0.45, 0.62, 0.48, 1.0)
_WOOD = (0.78, 0.70, 0.58, 1.0)

Path = Callable[[float], Vector]
"""Wrist offset [m] in the world at a time [s]."""


@dataclass(frozen=True, slots=True)
class SceneSetup:
    """What one episode starts with."""

    object: ObjectSpec
    position: Array
    """Centre of the object in the hand frame, shape (3,) [m]."""
    yaw: float
    """Turn of the object about the vertical [rad]."""
    synergy: Array
    """Hand at the start, shape (6,) [rad]."""
    hand: Hand = HPAC
    hand_settings: HandSettings = field(default_factory=HandSettings)
    hand_quaternion: tuple[float, float, float, float] = HAND_QUATERNION
    """Orientation of the hand's frame in the world, xyzw."""
    object_quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation of the object in the world before its yaw, xyzw."""
    support: Support | None = None
    """What the object stands on; None is a post that does not turn with it."""
    target: Array | None = None
    """Centre of the object where it shall stand later, on a post of its own, as `position`; None for nowhere."""


class Scene:
    """One world with a hand, an object and its support, set anew for every episode.

    Args:
        settings: of the world.
        visuals: load what only a camera sees; without it a reset is faster and the physics the same.

    Attributes:
        setup: what the episode started with.
        hand_rotation: of the hand's frame in the world, shape (3, 3); the wrist slides, but does not turn.
        target: where the object shall stand, its centre in the world, shape (3,) [m]; only with a setup that has one.
    """

    def __init__(self, settings: WorldSettings = WorldSettings(), visuals: bool = True) -> None:
        self._stage = Stage("hpac_hand_on_wrist.urdf", tuple(HAND_POSITION), settings, visuals)
        self.world = self._stage.world
        self._visuals = visuals
        self.time = 0.0

    def reset(self, setup: SceneSetup) -> None:
        """Set the scene. The same setup gives the same trajectory, to the bit, whatever was before."""
        self.time, self.setup = 0.0, setup
        self.hand = self._stage.start(setup.hand, setup.hand_settings, setup.hand_quaternion)
        self.hand.reset(setup.synergy)
        self.hand_rotation = _matrix(setup.hand_quaternion)
        self.wrist = Wrist(self.hand, self.hand_rotation)
        centre = HAND_POSITION + self.hand_rotation @ setup.position
        turn = (0.0, 0.0, np.sin(setup.yaw / 2), np.cos(setup.yaw / 2))
        orientation = _turned(setup.object_quaternion, turn)
        self.object = SimObject(self.world, setup.object, centre, orientation, self._visuals)
        self._add_support(setup, centre, turn)
        for body in (self.object.body, *self._supports):
            self._stage.add(body)
        self._offset = self.wrist.offset

    def _add_support(self, setup: SceneSetup, centre: Array, turn: tuple[float, float, float, float]) -> None:
        reach = np.abs(_matrix(setup.object_quaternion)[2]) @ setup.object.half_extents
        support = setup.support or Support((POST_HALF_WIDTH, POST_HALF_WIDTH))
        turn = turn if setup.support else (0.0, 0.0, 0.0, 1.0)
        floor = support.table_height
        below, turned = np.array([centre[0], centre[1], floor]), _matrix(turn)
        boxes = [
            add_fixed_box(self.world, half_extents, below + turned @ place, self._color(_GREY), _POST_FRICTION, turn)
            for half_extents, place in support.boxes(centre[2] - reach - floor)
        ]
        place = (centre[0], centre[1], floor - 0.01)
        table = add_fixed_box(self.world, (0.35, 0.35, 0.01), place, self._color(_WOOD), _POST_FRICTION)
        self._supports = (*boxes, table)
        self._target_post: int | None = None
        if setup.target is not None:
            self.target = HAND_POSITION + self.hand_rotation @ setup.target
            self._target_post = self._add_target(self.target - [0.0, 0.0, reach])
            self._supports = (*self._supports, self._target_post)

    def _add_target(self, top: Array) -> int:
        half_extents = (TARGET_HALF_WIDTH, TARGET_HALF_WIDTH, top[2] / 2)
        return add_fixed_box(self.world, half_extents, (top[0], top[1], top[2] / 2), self._color(_GREEN), _POST_FRICTION)

    def _color(self, color: tuple[float, ...]) -> tuple[float, ...] | None:
        return color if self._visuals else None

    def advance(self, command: ServoCommand, path: Path) -> None:
        """Carry out one servo command while the wrist follows its path: whole physics steps that fill its duration."""
        dt = self.world.settings.dt
        self.hand.command(command)
        for _ in range(round(command.duration / dt)):
            self.time += dt
            self.wrist.move(path(self.time))
            self.hand.apply_tendons()
            self.object.lose_spin(dt)
            self.world.step()
        self._offset = self.wrist.offset

    def object_pose(self) -> tuple[Array, Array]:
        """Centre, shape (3,) [m], and rotation, shape (3, 3), of the object in the frame of the hand."""
        position, quaternion = self.object.pose()
        to_hand = self.hand_rotation.T
        return to_hand @ (position - HAND_POSITION - self._offset), to_hand @ _matrix(quaternion.tolist())

    def contact_forces(self) -> dict[str, float]:
        """Normal force between the object and the palm and every digit that touches it [N]."""
        forces: dict[str, float] = {}
        for contact in pybullet.getContactPoints(self.hand.body, self.object.body, physicsClientId=self.world.client):
            if contact[8] <= 0:
                part = self.hand.part_of_link[contact[3]]
                forces[part] = forces.get(part, 0.0) + contact[9]
        return forces

    @property
    def palm_position(self) -> Array:
        """Where the wrist is now in the world, shape (3,) [m]."""
        return HAND_POSITION + self._offset

    @property
    def palm_offset(self) -> Array:
        """How far the wrist is now from where it started, in the world, shape (3,) [m]."""
        return self._offset

    @property
    def on_support(self) -> bool:
        """Whether the object touches the post or the table."""
        return any(
            pybullet.getContactPoints(self.object.body, support, physicsClientId=self.world.client)
            for support in self._supports
        )

    @property
    def on_target(self) -> bool:
        """Whether the object touches the post where it shall stand."""
        post, client = self._target_post, self.world.client
        return post is not None and bool(pybullet.getContactPoints(self.object.body, post, physicsClientId=client))

    def close(self) -> None:
        """Leave the physics client. Closing twice is no error."""
        self._stage.close()


def _matrix(quaternion: Sequence[float]) -> Array:
    """The rotation matrix of a quaternion xyzw, shape (3, 3)."""
    return np.reshape(pybullet.getMatrixFromQuaternion(quaternion), (3, 3))


def _turned(quaternion: Sequence[float], turn: Sequence[float]) -> tuple[float, ...]:
    """A quaternion xyzw after a turn about the vertical; unlike PyBullet's product it leaves the identity's bits alone."""
    (x, y, z, w), (_, _, sine, cosine) = quaternion, turn
    return cosine * x - sine * y, cosine * y + sine * x, cosine * z + sine * w, cosine * w - sine * z
