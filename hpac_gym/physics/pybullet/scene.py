"""One PyBullet world of the engine: a hand that stays loaded, and the object, supports and table of
the current episode.
"""

import numpy as np
import pybullet

from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup
from hpac_gym.physics.pybullet.hand import SimHand
from hpac_gym.physics.pybullet.objects import SimObject, add_fixed_box
from hpac_gym.physics.pybullet.world import World
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.physics.supports import COLORS, support_boxes

_EPISODES = 200
"""Number of episodes after which the hand is loaded again."""
BODY = 2
LINK = 4
POINT = 5
NORMAL = 7
DISTANCE = 8
FORCE = 9
"""Indices into a PyBullet contact of the object: the other body and its link, point on the object,
normal into the object, distance, normal force.
"""


class Scene:
    """One world of the engine, reset for every episode.

    Loading a hand takes a hundred times as long as restoring a snapshot, so the loaded hand is
    reconfigured. The snapshot is taken after a physics step, without which PyBullet does not replay
    bit-exactly.

    Args:
        settings: settings of the world.
        visuals: load visual shapes.

    Attributes:
        hand: the simulated hand.
        setup: the setup of the current episode; None before the first one.
        time: time since the episode began [s].
        past: the tables of the episode so far, those of a control step in a row.
        object: the simulated object; None for a hand alone.
        target_post: the body at the setup's target; None without one.
    """

    def __init__(self, settings: WorldSettings, visuals: bool) -> None:
        self.world = World(settings, visuals)
        self.setup: SceneSetup | None = None
        self.time = 0.0
        self._loaded: tuple | None = None
        """`_loaded_for` of the hand's setup; None unless the hand is ready."""
        self._episodes = 0

    def reset(self, setup: SceneSetup) -> None:
        """Set up an episode. The same setup gives the same trajectory, to the bit, regardless of
        earlier episodes.
        """
        self.setup = setup
        self.time = 0.0
        self.past: list[tuple[Array | None, ...]] = []
        self._prepare(setup)
        self.hand.reset(setup.synergy)
        self.object: SimObject | None = None
        self.target_post: int | None = None
        self.to_hand = matrix(setup.hand_quaternion).T
        if setup.object is None:
            return
        centre = HAND_POSITION + self.to_hand.T @ setup.position
        orientation, _ = setup.object_turn
        self.object = SimObject(self.world, setup.object, centre, orientation, setup.fixed)
        # Bullet multiplies it by the other body's lateral friction.
        spinning = (self.world.settings.torsion or 0.0) / setup.hand_settings.contact_friction
        pybullet.changeDynamics(
            self.object.body, -1, spinningFriction=spinning, physicsClientId=self.world.client
        )
        for box in () if setup.fixed else support_boxes(setup, matrix):
            body = add_fixed_box(
                self.world, box.half_extents, box.centre, COLORS[box.kind], box.quaternion
            )
            if box.kind == "target":
                self.target_post = body

    def fits(self, setup: SceneSetup) -> bool:
        """Whether the hand that is loaded is one for this setup."""
        return self._loaded == _loaded_for(setup)

    def _prepare(self, setup: SceneSetup) -> None:
        """Put the setup's hand at rest into the otherwise empty world. It is loaded again after an
        interrupt, and every `_EPISODES` episodes, because PyBullet retains memory of every removed
        body and shape until the world is cleared, and with it up to 0.08 MB of the solver.
        """
        hand = setup.hand
        settings = setup.hand_settings
        client = self.world.client
        fits = self.fits(setup)
        self._loaded = None  # until the end of this function, if it gets there
        if not fits or self._episodes == _EPISODES:
            self.world.clear()
            on_wrist = setup.object is not None
            self.hand = SimHand(
                self.world, hand, settings, setup.geometry, on_wrist, setup.hand_quaternion
            )
            self._episodes = 0
            pybullet.stepSimulation(client)
            self._snapshot = pybullet.saveState(physicsClientId=client)
        elif self.hand.hand is not hand or self.hand.settings != settings:
            self.hand.configure(hand, settings)
        self._episodes += 1
        for index in reversed(range(pybullet.getNumBodies(client))):
            body = pybullet.getBodyUniqueId(index, client)
            if body != self.hand.body:
                pybullet.removeBody(body, physicsClientId=client)
        # Drop the cached pairs of nearby links: the solver processes contacts in the order in which
        # pairs first met.
        self.hand.collide(False)
        pybullet.performCollisionDetection(client)
        self.hand.collide(True)
        pybullet.restoreState(self._snapshot, physicsClientId=client)
        self._loaded = _loaded_for(setup)

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
        self.past.append((servo, servo_vel, wrist, push))
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
            self.time += dt
            if len(force_steps):
                force_steps[step] = sum(contact[FORCE] for contact in self.contacts()[0])

    def contacts(self) -> tuple[list[tuple], set[int]]:
        """PyBullet's contact points between object and hand, without those at a positive distance,
        and the other bodies that the object touches.
        """
        if self.object is None:
            return [], set()
        found = pybullet.getContactPoints(self.object.body, physicsClientId=self.world.client)
        hand = self.hand.body
        return (
            [contact for contact in found if contact[BODY] == hand and contact[DISTANCE] <= 0],
            {contact[BODY] for contact in found} - {hand},
        )


def _loaded_for(setup: SceneSetup) -> tuple:
    """What loading determines of a setup's hand: armature, orientation, mounting and geometry."""
    on_wrist = setup.object is not None
    return setup.hand_settings.armature, setup.hand_quaternion, on_wrist, setup.geometry


def matrix(quaternion: tuple[float, ...]) -> Array:
    """The rotation matrix of a quaternion xyzw, shape (3, 3)."""
    return np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
