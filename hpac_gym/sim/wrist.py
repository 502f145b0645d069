"""The wrist: three slides that carry the palm along a path, with the force of a robot arm."""

from __future__ import annotations

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.model.checks import Array
from hpac_gym.sim.hand import SimHand

SLIDES = ("wrist_x", "wrist_y", "wrist_z")
FORCE_LIMIT = 200.0
"""What the arm can push along each axis [N]."""
_POSITION_GAIN = 0.5


class Wrist:
    """Moves a hand of `hpac_hand_on_wrist.urdf` relative to where it was loaded.

    Args:
        hand: the hand.
        rotation: of the hand's frame in the world, shape (3, 3).
    """

    def __init__(self, hand: SimHand, rotation: ArrayLike) -> None:
        self._hand = hand
        self._slides = [hand.joint_index[name] for name in SLIDES]
        self._to_slides = np.asarray(rotation, dtype=float).T
        self._last: tuple[list[float], list[float]] | None = None
        self.move(np.zeros(3), np.zeros(3))

    def move(self, offset: Array, velocity: Array) -> None:
        """Say where the palm shall be at the end of the next physics step.

        Args:
            offset: from the start, in the world, shape (3,) [m].
            velocity: shape (3,) [m/s].
        """
        wanted = (self._to_slides @ offset).tolist(), (self._to_slides @ velocity).tolist()
        if wanted == self._last:  # the motors keep what they were told
            return
        self._last = wanted
        pybullet.setJointMotorControlArray(
            self._hand.body,
            self._slides,
            pybullet.POSITION_CONTROL,
            targetPositions=wanted[0],
            targetVelocities=wanted[1],
            forces=[FORCE_LIMIT] * 3,
            positionGains=[_POSITION_GAIN] * 3,
            velocityGains=[1.0] * 3,
            physicsClientId=self._hand.world.client,
        )
