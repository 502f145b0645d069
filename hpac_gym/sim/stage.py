"""A world with one hand, loaded once and put back to its start for every episode."""

from __future__ import annotations

import pybullet

from hpac_gym.model import Hand
from hpac_gym.sim.hand import HandSettings, SimHand
from hpac_gym.sim.world import World, WorldSettings

Quaternion = tuple[float, float, float, float]

EPISODES = 200
"""Between two loadings of the hand."""


class Stage:
    """Loading a hand takes a hundred times as long as a snapshot, so the hand stays, and becomes the next one.

    The snapshot is taken after a physics step, without which PyBullet does not replay to the bit. Every `EPISODES`, and for
    another armature or orientation, the hand is loaded all the same: PyBullet keeps some memory of every body and shape that
    ever was, until the world is cleared.

    Args:
        urdf: of the hand, as for `SimHand`.
        position: of the wrist in the world, shape (3,) [m].
        settings: of the world.
        visuals: load what only a camera sees.
    """

    def __init__(
        self,
        urdf: str,
        position: tuple[float, float, float],
        settings: WorldSettings = WorldSettings(),
        visuals: bool = True,
    ) -> None:
        self.world = World(settings)
        self._urdf, self._position, self._visuals = urdf, position, visuals
        self._hand: SimHand | None = None
        self._episodes = 0
        self._added: list[int] = []

    def add(self, body: int) -> None:
        """Have a body removed before the next episode."""
        self._added.append(body)

    def start(self, hand: Hand, settings: HandSettings, orientation: Quaternion) -> SimHand:
        """A hand at rest in an otherwise empty world. What follows is the same to the bit, whatever was before.

        Args:
            hand: the model's parameters.
            settings: what the simulation adds.
            orientation: of the hand's frame in the world, quaternion xyzw.
        """
        start = settings.armature, orientation
        if self._hand is None or self._start != start or self._episodes == EPISODES:
            self._load(hand, settings, orientation)
        elif self._hand.hand is not hand or self._hand.settings != settings:
            self._hand.configure(hand, settings)
        self._start, self._episodes = start, self._episodes + 1
        for body in reversed(self._added):
            pybullet.removeBody(body, physicsClientId=self.world.client)
        self._added.clear()
        self._forget_contacts()
        pybullet.restoreState(self._snapshot, physicsClientId=self.world.client)
        return self._hand

    def _forget_contacts(self) -> None:
        """Drop the pairs of links that are near each other: the solver takes contacts in the order in which pairs met."""
        self._hand.collide(False)
        pybullet.performCollisionDetection(self.world.client)
        self._hand.collide(True)

    def _load(self, hand: Hand, settings: HandSettings, orientation: Quaternion) -> None:
        self.world.clear()
        self._added.clear()
        self._hand = SimHand(self.world, hand, settings, self._urdf, self._position, orientation, self._visuals)
        self._episodes = 0
        self.world.step()
        self._snapshot = pybullet.saveState(physicsClientId=self.world.client)

    def close(self) -> None:
        """Leave the physics client. Closing twice is no error."""
        self.world.close()
