"""Six position servos in each of n worlds: a commanded ramp, and horns that follow it with limited
speed and a dead band.

The ramp is the firmware's response to a `ServoCommand`: all six move linearly from their current
ramp positions and arrive together. Servos run open loop, so the motion of a whole control step is
one table. The tendon law limits a servo's force."""

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
        horn: horn angles as measured by the servos' encoders, shape (n, 6) [rad].
        zero: true angle of each horn when its encoder reads 0, shape (n, 6) [rad].

    Args:
        num_worlds: n.
        dt: physics step [s].
    """

    def __init__(self, num_worlds: int, dt: float) -> None:
        self._dt = dt
        self.horn = np.zeros((num_worlds, len(SERVOS)))
        self.zero = np.zeros((num_worlds, len(SERVOS)))
        self._start = self.horn.copy()
        self._way = self.horn.copy()
        self._elapsed = np.ones((num_worlds, 1))
        self._duration = np.ones((num_worlds, 1))
        self._reach = np.zeros((num_worlds, 1))
        self._dead_band = np.zeros((num_worlds, 1))
        self._late = np.zeros(num_worlds, dtype=int)
        # The latest ramp positions, as many as the largest lag in steps.
        self._past = np.zeros((num_worlds, 0, len(SERVOS)))

    def reset(
        self,
        worlds: Sequence[int],
        servo: ArrayLike,
        settings: Sequence[ServoSettings],
        zero: ArrayLike = 0.0,
    ) -> None:
        """Reset the servos of some worlds to rest at given angles, with given zeros, both of shape
        (len(worlds), 6) [rad].
        """
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
            self._past = np.concatenate(
                [np.repeat(self._start[:, None], missing, axis=1), self._past], axis=1
            )
        self._past[index] = self._start[index][:, None]

    @property
    def commanded(self) -> Array:
        """Current commanded angles, on their ramps to the targets, shape (n, 6) [rad]."""
        return self._start + np.minimum(self._elapsed / self._duration, 1.0) * self._way

    def command(self, servo: Array, duration: float) -> None:
        """Start a move in every world from its current ramp position to angles, shape (n, 6) [rad],
        within a duration [s].
        """
        self._start = self.commanded
        self._way = servo - self._start
        self._elapsed = np.zeros_like(self._elapsed)
        self._duration = np.full_like(self._duration, duration)

    def advance(self, steps: int) -> tuple[Array, Array]:
        """Advance by physics steps; returns the horns' true angles [rad] and speeds [rad/s], shapes
        (n, steps, 6).
        """
        elapsed = np.cumsum(
            np.concatenate([self._elapsed, np.full((len(self.horn), steps), self._dt)], axis=1),
            axis=1,
        )[:, 1:]
        self._elapsed = elapsed[:, -1:]
        share = np.minimum(elapsed / self._duration, 1.0)[:, :, None]
        told = self._start[:, None] + share * self._way[:, None]
        if kept := self._past.shape[1]:
            ramp = np.concatenate([self._past, told], axis=1)
            row = kept + np.arange(steps) - self._late[:, None]
            told = np.take_along_axis(ramp, row[:, :, None], axis=1)
            self._past = ramp[:, -kept:]
        angle = np.empty_like(told)
        speed = np.empty_like(told)
        horn = self.horn
        for step in range(steps):
            error = told[:, step] - horn
            moved = np.minimum(np.maximum(error, -self._reach), self._reach)
            moved[np.abs(error) <= self._dead_band] = 0.0
            horn = horn + moved
            angle[:, step] = horn
            speed[:, step] = moved / self._dt
        self.horn = horn
        angle += self.zero[:, None]
        return angle, speed
