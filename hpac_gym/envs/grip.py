"""Whether the hand holds the object: one definition for every task, and what `info` calls hold time and slip."""

from __future__ import annotations

import numpy as np

from hpac_gym.model.checks import Array

MAX_SLIP = 0.02
"""An object whose centre moves farther than this in the hand while it is carried has slipped out of its grasp [m]."""
_MISSED_STEPS = 1
"""Control steps without a contact that are no loss: an object that a shake lifts off one finger comes down on another."""


class Grip:
    """Follows one episode.

    The hand carries the object while it touches it and no support does. It holds the object while it carries it without a
    break and the object has slipped no farther than `MAX_SLIP` since the carrying began, or since the grasp has settled.

    Attributes:
        time: for how long the hand has carried the object without a break [s].
        slip: how far the object's centre has moved in the hand since then, or since `settle` [m].
    """

    def __init__(self) -> None:
        self._let_go()

    def _let_go(self) -> None:
        self.time, self.slip = 0.0, 0.0
        self._missed = 0
        self._began_at: Array | None = None

    def follow(self, object_pos: Array, touched: bool, supported: bool, dt: float) -> None:
        """Advance by one control step of `dt` seconds.

        Args:
            object_pos: true centre of the object in the hand frame, shape (3,) [m].
            touched: by the hand.
            supported: by anything else.
            dt: control period [s].
        """
        self._now = object_pos
        self._missed = 0 if touched else self._missed + 1
        carrying = touched or (self._began_at is not None and self._missed <= _MISSED_STEPS)
        if supported or not carrying:
            self._let_go()
            return
        if self._began_at is None:
            self._began_at = object_pos
        self.time += dt
        self.slip = float(np.linalg.norm(object_pos - self._began_at))

    def settle(self) -> None:
        """Count the slip of an object that is carried from here on: what it moved while the hand took hold is no slip."""
        if self._began_at is not None:
            self._began_at, self.slip = self._now, 0.0

    @property
    def firmness(self) -> float:
        """1 for an object that is carried and has not slipped, 0 for one that is lost or has slipped by `MAX_SLIP`."""
        return max(1.0 - self.slip / MAX_SLIP, 0.0) if self._began_at is not None else 0.0

    @property
    def holds(self) -> bool:
        """Whether the hand holds the object now."""
        return self._began_at is not None and self.slip <= MAX_SLIP
