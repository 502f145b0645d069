"""Six position servos in each of n worlds: a commanded ramp, and horns that follow it with limited speed and a dead band.

The ramp is what the firmware does with a `ServoCommand`: all six move linearly from where their ramp stands, and arrive
together. Servos never look at the physics, so the motion of a whole control step is one table. How hard a servo pulls is
limited where it pulls: in the tendon law.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model import SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.physics.settings import ServoSettings


class Servos:
    """The servos of n worlds.

    Attributes:
        horn: where the horns are for their own encoders, shape (n, 6) [rad].
        zero: where each horn stands in truth when it is at 0 for its own encoder, shape (n, 6) [rad].

    Args:
        num_worlds: n.
        dt: physics step [s].
    """

    def __init__(self, num_worlds: int, dt: float) -> None:
        self._dt = dt
        self.horn, self.zero = np.zeros((num_worlds, len(SERVOS))), np.zeros((num_worlds, len(SERVOS)))
        self._start, self._way = self.horn.copy(), self.horn.copy()
        self._elapsed, self._duration = np.ones((num_worlds, 1)), np.ones((num_worlds, 1))
        self._reach, self._dead_band = np.zeros((num_worlds, 1)), np.zeros((num_worlds, 1))
        self._late = np.zeros(num_worlds, dtype=int)
        self._past = np.zeros((num_worlds, 0, len(SERVOS)))  # the newest ramp positions, as many as the latest servo is late

    def reset(
        self, worlds: Sequence[int], servo: ArrayLike, settings: Sequence[ServoSettings], zero: ArrayLike = 0.0
    ) -> None:
        """Stand still in some worlds, at angles of shape (len(worlds), 6) [rad], with their settings and zeros, of that shape."""
        index = np.asarray(worlds)
        self.zero[index] = zero
        self.horn[index] = self._start[index] = servo
        self._way[index] = 0.0
        self._elapsed[index] = self._duration[index] = 1.0
        self._reach[index, 0] = [given.speed * self._dt for given in settings]
        self._dead_band[index, 0] = [given.dead_band for given in settings]
        self._late[index] = [round(given.lag / self._dt) for given in settings]
        missing = self._late.max() - self._past.shape[1]
        if missing > 0:
            self._past = np.concatenate([np.repeat(self._start[:, None], missing, axis=1), self._past], axis=1)
        self._past[index] = self._start[index][:, None]

    @property
    def commanded(self) -> Array:
        """Commanded angles now, on their ramps to the targets, shape (n, 6) [rad]."""
        return self._start + np.minimum(self._elapsed / self._duration, 1.0) * self._way

    def command(self, servo: Array, duration: float) -> None:
        """Start a move in every world from where its ramp stands: to angles (n, 6) [rad] within a duration [s]."""
        self._start = self.commanded
        self._way = servo - self._start
        self._elapsed, self._duration = np.zeros_like(self._elapsed), np.full_like(self._duration, duration)

    def advance(self, steps: int) -> tuple[Array, Array]:
        """Move on by some physics steps: the horns' true angles [rad] and speeds [rad/s] in each, shapes (n, steps, 6)."""
        elapsed = np.cumsum(np.concatenate([self._elapsed, np.full((len(self.horn), steps), self._dt)], axis=1), axis=1)[:, 1:]
        self._elapsed = elapsed[:, -1:]
        share = np.minimum(elapsed / self._duration, 1.0)[:, :, None]
        told = self._start[:, None] + share * self._way[:, None]
        if kept := self._past.shape[1]:
            ramp = np.concatenate([self._past, told], axis=1)
            row = kept + np.arange(steps) - self._late[:, None]
            told, self._past = np.take_along_axis(ramp, row[:, :, None], axis=1), ramp[:, -kept:]
        angle, speed = np.empty_like(told), np.empty_like(told)
        horn = self.horn
        for step in range(steps):
            error = told[:, step] - horn
            moved = np.minimum(np.maximum(error, -self._reach), self._reach)
            moved[np.abs(error) <= self._dead_band] = 0.0
            horn = horn + moved
            angle[:, step], speed[:, step] = horn, moved / self._dt
        self.horn = horn
        angle += self.zero[:, None]
        return angle, speed
