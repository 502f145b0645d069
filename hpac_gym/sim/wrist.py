"""The wrist: three slides that carry the palm along a path, with the force of a robot arm."""

from __future__ import annotations

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.sim.hand import SimHand

Vector = tuple[float, float, float]
"""Along the axes of the world."""

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
        self._axes = np.transpose(rotation).tolist()
        self._last: tuple[Vector, Vector] | None = None
        self.move((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))

    def move(self, offset: Vector, velocity: Vector) -> None:
        """Say where the palm shall be at the end of the next physics step.

        Args:
            offset: from the start, in the world, shape (3,) [m].
            velocity: shape (3,) [m/s].
        """
        if (offset, velocity) == self._last:  # the motors keep what they were told
            return
        self._last = offset, velocity
        pybullet.setJointMotorControlArray(
            self._hand.body,
            self._slides,
            pybullet.POSITION_CONTROL,
            targetPositions=self._along_slides(offset),
            targetVelocities=self._along_slides(velocity),
            forces=[FORCE_LIMIT] * 3,
            positionGains=[_POSITION_GAIN] * 3,
            velocityGains=[1.0] * 3,
            physicsClientId=self._hand.world.client,
        )

    def _along_slides(self, vector: Vector) -> list[float]:
        x, y, z = vector
        return [a * x + b * y + c * z for a, b, c in self._axes]
