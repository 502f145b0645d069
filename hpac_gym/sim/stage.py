"""A world with one hand, loaded once and put back to its start for every episode."""

from __future__ import annotations

import pybullet

from hpac_gym.model import Hand
from hpac_gym.sim.hand import HandSettings, SimHand
from hpac_gym.sim.world import World, WorldSettings

Quaternion = tuple[float, float, float, float]


class Stage:
    """Loading a hand takes a hundred times as long as a snapshot, so the hand stays as long as the next one is the same.

    The snapshot is taken after a physics step, without which PyBullet does not replay to the bit.

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
        known = self._hand
        if known is None or known.hand is not hand or (known.settings, self._orientation) != (settings, orientation):
            self._load(hand, settings, orientation)
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
        self._orientation = orientation
        self.world.step()
        self._snapshot = pybullet.saveState(physicsClientId=self.world.client)

    def close(self) -> None:
        """Leave the physics client. Closing twice is no error."""
        self.world.close()
