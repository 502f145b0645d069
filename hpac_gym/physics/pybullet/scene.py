"""One PyBullet world of the engine: a hand that stays loaded, and the object, supports and table of
the current episode.
"""

from __future__ import annotations

import numpy as np
import pybullet

from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup
from hpac_gym.physics.pybullet.hand import SimHand
from hpac_gym.physics.pybullet.objects import SimObject, add_fixed_box
from hpac_gym.physics.pybullet.world import World
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.physics.supports import (
    GREEN,
    GREY,
    SUPPORT_FRICTION,
    TABLE_HALF_EXTENTS,
    WOOD,
    support_boxes,
)

_EPISODES = 200
"""Number of episodes after which the hand is loaded again."""
LINK = 3
POINT = 6
NORMAL = 7
DISTANCE = 8
FORCE = 9
"""Indices into a PyBullet contact: link of the hand, point on the object, normal out of the object,
distance, normal force.
"""


class Stage:
    """One PyBullet world with one loaded hand, and its snapshot at rest.

    Loading a hand takes a hundred times as long as restoring a snapshot, so the loaded hand is
    reconfigured. The snapshot is taken after a physics step, without which PyBullet does not replay
    bit-exactly.

    Args:
        settings: settings of the world.
        visuals: load visual shapes.
    """

    def __init__(self, settings: WorldSettings, visuals: bool) -> None:
        self.world = World(settings)
        self._visuals = visuals
        self.hand: SimHand | None = None
        self.start: tuple | None = None
        """What loading determines: armature, orientation, mounting and geometry of the hand."""
        self._added: list[int] = []
        self._episodes = 0

    def prepare(self, setup: SceneSetup) -> None:
        """Put the setup's hand at rest into the otherwise empty world. It is loaded again every
        `_EPISODES` episodes, because PyBullet retains memory of every removed body and shape until
        the world is cleared.
        """
        hand = setup.hand
        settings = setup.hand_settings
        client = self.world.client
        if (start := start_of(setup)) != self.start or self._episodes == _EPISODES:
            if self.hand is not None:
                self.world.clear()
                self._added.clear()
            _, quaternion, on_wrist, geometry = start
            self.hand = SimHand(
                self.world, hand, settings, geometry, on_wrist, quaternion, self._visuals
            )
            self.start = start
            self._episodes = 0
            pybullet.stepSimulation(client)
            self._snapshot = pybullet.saveState(physicsClientId=client)
        elif self.hand.hand is not hand or self.hand.settings != settings:
            self.hand.configure(hand, settings)
        self._episodes += 1
        for body in reversed(self._added):
            pybullet.removeBody(body, physicsClientId=client)
        self._added.clear()
        # Drop the cached pairs of nearby links: the solver processes contacts in the order in which
        # pairs first met.
        self.hand.collide(False)
        pybullet.performCollisionDetection(client)
        self.hand.collide(True)
        pybullet.restoreState(self._snapshot, physicsClientId=client)

    def add(self, *bodies: int) -> None:
        """Bodies to be removed before the next episode."""
        self._added += bodies


def start_of(setup: SceneSetup) -> tuple:
    """What a setup asks of a loaded hand; see `Stage.start`."""
    on_wrist = setup.object is not None
    return setup.hand_settings.armature, setup.hand_quaternion, on_wrist, setup.geometry


class Scene:
    """One world of the engine, reset for every episode; a hand that starts otherwise, as in another
    orientation, may have a `Stage` of its own.

    Args:
        settings: settings of the world.
        visuals: load visual shapes.
        stages: number of loaded hands that are kept, each in a PyBullet world of 34 MB.

    Attributes:
        world: the PyBullet world of the current episode.
        hand: the simulated hand.
        object: the simulated object; None for a hand alone.
        supports: bodies that the object may stand on: posts, walls, table, and the target's post.
        target_post: the body at the setup's target; None without one.
    """

    def __init__(self, settings: WorldSettings, visuals: bool, stages: int = 1) -> None:
        self._room = stages
        self._settings = settings
        self._visuals = visuals
        self._stages = [Stage(settings, visuals)]
        self.world = self._stages[0].world
        self.hand: SimHand | None = None

    def reset(self, setup: SceneSetup) -> None:
        """Set up an episode. The same setup gives the same trajectory, to the bit, regardless of
        earlier episodes.
        """
        stage = self._staged(setup)
        self.world = stage.world
        self.hand = stage.hand
        self.hand.reset(setup.synergy)
        self.object: SimObject | None = None
        self.supports: tuple[int, ...] = ()
        self.target_post: int | None = None
        self.to_hand = _matrix(setup.hand_quaternion).T
        if setup.object is None:
            return
        centre = HAND_POSITION + self.to_hand.T @ setup.position
        orientation, _ = setup.object_turn
        self.object = SimObject(
            self.world, setup.object, centre, orientation, self._visuals, setup.fixed
        )
        if (
            torsion := self.world.settings.torsion
        ):  # Bullet multiplies it by the other body's lateral friction
            spinning = torsion / setup.hand_settings.contact_friction
            pybullet.changeDynamics(
                self.object.body, -1, spinningFriction=spinning, physicsClientId=self.world.client
            )
        if not setup.fixed:
            self._add_supports(setup)
        stage.add(self.object.body, *self.supports)

    def _staged(self, setup: SceneSetup) -> Stage:
        """The stage of a setup, with its hand at rest; the last one used is the last of the list."""
        start = start_of(setup)
        stages = self._stages
        same = [stage for stage in stages if stage.start in (start, None)]
        if not same and len(stages) < self._room:
            same = [Stage(self._settings, self._visuals)]
        stage = same[0] if same else stages[0]
        self._stages = [*(other for other in stages if other is not stage), stage]
        stage.prepare(setup)
        return stage

    def _add_supports(self, setup: SceneSetup) -> None:
        boxes, table, target, turn = support_boxes(setup, _matrix)
        posts = [self._fixed_box(half_extents, place, GREY, turn) for half_extents, place in boxes]
        self.supports = (*posts, self._fixed_box(TABLE_HALF_EXTENTS, table, WOOD))
        if target is not None:
            self.target_post = self._fixed_box(*target, GREEN)
            self.supports = (*self.supports, self.target_post)

    def _fixed_box(self, half_extents, position, color, turn=(0.0, 0.0, 0.0, 1.0)) -> int:
        return add_fixed_box(
            self.world,
            half_extents,
            position,
            color if self._visuals else None,
            SUPPORT_FRICTION,
            turn,
        )

    def advance(
        self,
        servo: Array,
        servo_vel: Array,
        wrist: Array,
        push: Array | None,
        force_steps: Array | tuple[()] = (),
    ) -> None:
        """Carry out k physics steps, one row of each table per step: shapes (k, 6) [rad], (k, 6)
        [rad/s], (k, 3) [m] and (k, 3) [N], or None for no push. The hand's normal forces on the
        object are summed into `force_steps`, shape (k,) [N], or (0,) if nobody asks."""
        dt = self.world.settings.dt
        client = self.world.client
        hand = self.hand
        item = self.object
        swings = item is not None and item.spec.model is not None
        pushes = [None] * len(servo) if item is None or push is None else push.tolist()
        for step, (angles, speeds, offset, force) in enumerate(
            zip(servo.tolist(), servo_vel.tolist(), wrist.tolist(), pushes, strict=True)
        ):
            hand.move_wrist(offset)
            hand.apply_tendons(angles, speeds)
            if swings:
                item.lose_spin(dt)
            if force is not None:
                item.push(force)
            pybullet.stepSimulation(client)
            if len(force_steps) and item is not None:
                force_steps[step] = sum(contact[FORCE] for contact in self.contacts())

    def close(self) -> None:
        """Disconnect from all worlds. Closing twice is allowed."""
        for stage in self._stages:
            stage.world.close()

    def touches(self, body: int) -> bool:
        """True if the object touches another body."""
        return bool(
            pybullet.getContactPoints(self.object.body, body, physicsClientId=self.world.client)
        )

    def contacts(self) -> list[tuple]:
        """PyBullet's contact points between hand and object, without those at a positive
        distance.
        """
        if self.object is None:
            return []
        found = pybullet.getContactPoints(
            self.hand.body, self.object.body, physicsClientId=self.world.client
        )
        return [contact for contact in found if contact[DISTANCE] <= 0]


def _matrix(quaternion: tuple[float, ...]) -> Array:
    """The rotation matrix of a quaternion xyzw, shape (3, 3)."""
    return np.reshape(pybullet.getMatrixFromQuaternion(quaternion), (3, 3))
