"""The wrist: three slides that carry the palm along a path, with the force of a robot arm."""

from __future__ import annotations

import numpy as np
import pybullet
from numpy.typing import ArrayLike

from hpac_gym.model.checks import Array
from hpac_gym.sim.hand import SimHand

Vector = tuple[float, float, float]
"""Along the axes of the world."""

SLIDES = ("wrist_x", "wrist_y", "wrist_z")
FORCE_LIMIT = 200.0
"""What the arm can push along each axis [N]."""


class Wrist:
    """Moves a hand of `hpac_hand_on_wrist.urdf` relative to where it was loaded, and where it begins.

    Args:
        hand: the hand.
        rotation: of the hand's frame in the world, shape (3, 3).
    """

    def __init__(self, hand: SimHand, rotation: ArrayLike) -> None:
        self._hand = hand
        self._slides = [hand.joint_index[name] for name in SLIDES]
        self._rotation = np.asarray(rotation)
        self._axes = self._rotation.T.tolist()
        self._last: Vector | None = None
        for slide in self._slides:
            pybullet.resetJointState(hand.body, slide, 0.0, 0.0, physicsClientId=hand.world.client)
        self.move((0.0, 0.0, 0.0))

    def move(self, offset: Vector) -> None:
        """Say where the palm shall be at the end of the next physics step; unless a force beyond `FORCE_LIMIT` resists, it is.

        Args:
            offset: from the start, in the world, shape (3,) [m].
        """
        if offset == self._last:  # the motors keep what they were told
            return
        self._last = offset
        pybullet.setJointMotorControlArray(
            self._hand.body,
            self._slides,
            pybullet.POSITION_CONTROL,
            targetPositions=self._along_slides(offset),
            targetVelocities=[0.0] * 3,
            forces=[FORCE_LIMIT] * 3,
            positionGains=[1.0] * 3,
            velocityGains=[1.0] * 3,
            physicsClientId=self._hand.world.client,
        )

    @property
    def offset(self) -> Array:
        """Where the palm is from the start, in the world, shape (3,) [m]."""
        states = pybullet.getJointStates(self._hand.body, self._slides, self._hand.world.client)
        return self._rotation @ [state[0] for state in states]

    def _along_slides(self, vector: Vector) -> list[float]:
        x, y, z = vector
        return [a * x + b * y + c * z for a, b, c in self._axes]
