"""Whether the hand holds the object: one definition for every task, and what `info` calls hold time and slip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model.checks import Array

MAX_SLIP = 0.02
"""An object whose centre moves farther than this in the hand while it is carried has slipped out of its grasp [m]."""
_MISSED_STEPS = 1
"""Control steps without a contact that are no loss: an object that a shake lifts off one finger comes down on another."""


class Grip:
    """Follows the episodes of n worlds.

    The hand carries the object while it touches it and no support does. It holds the object while it carries it without a
    break and the object has slipped no farther than `MAX_SLIP` since the carrying began, or since the grasp has settled.

    Attributes:
        carrying: whether the hand carries the object, shape (n,).
        time: for how long it has carried it without a break, shape (n,) [s].
        slip: how far the object's centre has moved in the hand since then, or since `settle`, shape (n,) [m].
    """

    def __init__(self, num_worlds: int) -> None:
        self.carrying = np.zeros(num_worlds, dtype=bool)
        self.time, self.slip = np.zeros(num_worlds), np.zeros(num_worlds)
        self._missed = np.zeros(num_worlds, dtype=int)
        self._origin, self._now = np.zeros((num_worlds, 3)), np.zeros((num_worlds, 3))

    def start(self, worlds: Sequence[int]) -> None:
        """Begin episodes: nothing is carried."""
        self._let_go(np.asarray(worlds))

    def _let_go(self, where: NDArray) -> None:
        self.carrying[where] = False
        self.time[where] = self.slip[where] = 0.0
        self._missed[where] = 0

    def follow(self, object_pos: Array, touched: NDArray[np.bool_], supported: NDArray[np.bool_], dt: float) -> None:
        """Advance by one control step of `dt` seconds.

        Args:
            object_pos: true centre of the object in the hand frame, shape (n, 3) [m].
            touched: by the hand, shape (n,).
            supported: by anything else, shape (n,).
            dt: control period [s].
        """
        self._now = object_pos
        self._missed = np.where(touched, 0, self._missed + 1)
        carries = (touched | (self.carrying & (self._missed <= _MISSED_STEPS))) & ~supported
        self._let_go(~carries)
        begins = carries & ~self.carrying
        self._origin[begins] = object_pos[begins]
        self.carrying = carries
        self.time[carries] += dt
        self.slip = np.where(carries, np.linalg.norm(object_pos - self._origin, axis=1), 0.0)

    def settle(self, where: NDArray[np.bool_]) -> None:
        """Count the slip from here on where it is carried: what the object moved while the hand took hold is no slip."""
        where = where & self.carrying
        self._origin[where] = self._now[where]
        self.slip[where] = 0.0

    @property
    def firmness(self) -> Array:
        """1 for an object that is carried and has not slipped, 0 for one that is lost or has slipped by `MAX_SLIP`."""
        return np.where(self.carrying, np.maximum(1.0 - self.slip / MAX_SLIP, 0.0), 0.0)

    @property
    def holds(self) -> NDArray[np.bool_]:
        """Whether the hand holds the object now."""
        return self.carrying & (self.slip <= MAX_SLIP)
