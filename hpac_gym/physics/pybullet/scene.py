"""One PyBullet world of the engine: a hand that stays loaded, and the object, supports and table of the present episode."""

from __future__ import annotations

import numpy as np
import pybullet

from hpac_gym.body.objects import Support
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    GREEN,
    GREY,
    HAND_POSITION,
    POST_HALF_WIDTH,
    SUPPORT_FRICTION,
    TABLE_HALF_EXTENTS,
    TARGET_HALF_WIDTH,
    WOOD,
    SceneSetup,
)
from hpac_gym.physics.pybullet.hand import HAND_ALONE, HAND_ON_WRIST, SimHand
from hpac_gym.physics.pybullet.objects import SimObject, add_fixed_box
from hpac_gym.physics.pybullet.world import World
from hpac_gym.physics.settings import WorldSettings

_EPISODES = 200
"""Between two loadings of the hand."""


class Scene:
    """Set anew for every episode.

    Loading a hand takes a hundred times as long as restoring a snapshot, so the hand stays and becomes the next one. The
    snapshot is taken after a physics step, without which PyBullet does not replay to the bit. Every `_EPISODES`, and for
    another armature, orientation or mounting, the hand is loaded all the same: PyBullet keeps some memory of every body and
    shape that ever was, until the world is cleared.

    Attributes:
        hand: the simulated hand.
        object: the simulated object; None for a hand alone.
        supports: bodies that the object may stand on: posts, walls, table, and the target's post.
        target_post: the body at the setup's target; None without one.
    """

    def __init__(self, settings: WorldSettings, visuals: bool) -> None:
        self.world, self._visuals = World(settings), visuals
        self.hand: SimHand | None = None
        self._added: list[int] = []
        self._episodes = 0

    def reset(self, setup: SceneSetup) -> None:
        """Set the scene. The same setup gives the same trajectory, to the bit, whatever was before."""
        self._start_hand(setup)
        self.hand.reset(setup.synergy)
        self.object: SimObject | None = None
        self.supports: tuple[int, ...] = ()
        self.target_post: int | None = None
        self.to_hand = _matrix(setup.hand_quaternion).T
        if setup.object is None:
            return
        centre = HAND_POSITION + self.to_hand.T @ setup.position
        orientation, turn = setup.object_turn
        self.object = SimObject(self.world, setup.object, centre, orientation, self._visuals, setup.fixed)
        if not setup.fixed:
            self._add_supports(setup, centre, turn)
        self._added += [self.object.body, *self.supports]

    def _start_hand(self, setup: SceneSetup) -> None:
        """A hand at rest in an otherwise empty world."""
        hand, settings = setup.hand, setup.hand_settings
        urdf = HAND_ALONE if setup.object is None else HAND_ON_WRIST
        start = settings.armature, setup.hand_quaternion, urdf
        if self.hand is None or self._start != start or self._episodes == _EPISODES:
            self.world.clear()
            self._added.clear()
            self.hand = SimHand(self.world, hand, settings, urdf, setup.hand_quaternion, self._visuals)
            self._start, self._episodes = start, 0
            self.world.step()
            self._snapshot = pybullet.saveState(physicsClientId=self.world.client)
        elif self.hand.hand is not hand or self.hand.settings != settings:
            self.hand.configure(hand, settings)
        self._episodes += 1
        for body in reversed(self._added):
            pybullet.removeBody(body, physicsClientId=self.world.client)
        self._added.clear()
        self._forget_contacts()
        pybullet.restoreState(self._snapshot, physicsClientId=self.world.client)

    def _forget_contacts(self) -> None:
        """Drop the pairs of links that are near each other: the solver takes contacts in the order in which pairs met."""
        self.hand.collide(False)
        pybullet.performCollisionDetection(self.world.client)
        self.hand.collide(True)

    def _add_supports(self, setup: SceneSetup, centre: Array, turn: tuple[float, float, float, float]) -> None:
        reach = np.abs(_matrix(setup.object_quaternion)[2]) @ setup.object.half_extents
        support = setup.support or Support((POST_HALF_WIDTH, POST_HALF_WIDTH))
        turn = turn if setup.support else (0.0, 0.0, 0.0, 1.0)
        floor = support.table_height
        below, turned = np.array([centre[0], centre[1], floor]), _matrix(turn)
        boxes = [
            self._fixed_box(half_extents, below + turned @ place, GREY, turn)
            for half_extents, place in support.boxes(centre[2] - reach - floor)
        ]
        table = self._fixed_box(TABLE_HALF_EXTENTS, (centre[0], centre[1], floor - 0.01), WOOD)
        self.supports = (*boxes, table)
        if setup.target is not None:
            x, y, z = HAND_POSITION + self.to_hand.T @ setup.target - [0.0, 0.0, reach]
            self.target_post = self._fixed_box((TARGET_HALF_WIDTH, TARGET_HALF_WIDTH, z / 2), (x, y, z / 2), GREEN)
            self.supports = (*self.supports, self.target_post)

    def _fixed_box(self, half_extents, position, color, turn=(0.0, 0.0, 0.0, 1.0)) -> int:
        return add_fixed_box(self.world, half_extents, position, color if self._visuals else None, SUPPORT_FRICTION, turn)

    def advance(self, servo: Array, servo_vel: Array, wrist: Array) -> None:
        """Carry out physics steps: a row of each table, shapes (k, 6) [rad], (k, 6) [rad/s] and (k, 3) [m], in each."""
        dt = self.world.settings.dt
        for angles, speeds, offset in zip(servo.tolist(), servo_vel.tolist(), wrist.tolist(), strict=True):
            self.hand.move_wrist(offset)
            self.hand.apply_tendons(angles, speeds)
            if self.object is not None:
                self.object.lose_spin(dt)
            self.world.step()

    def touches(self, body: int) -> bool:
        """Whether the object touches another body."""
        return bool(pybullet.getContactPoints(self.object.body, body, physicsClientId=self.world.client))

    def contacts(self) -> list[tuple]:
        """PyBullet's contact points between hand and object, without those that are only near."""
        if self.object is None:
            return []
        found = pybullet.getContactPoints(self.hand.body, self.object.body, physicsClientId=self.world.client)
        return [contact for contact in found if contact[8] <= 0]


def _matrix(quaternion: tuple[float, ...]) -> Array:
    """The rotation matrix of a quaternion xyzw, shape (3, 3)."""
    return np.reshape(pybullet.getMatrixFromQuaternion(quaternion), (3, 3))
