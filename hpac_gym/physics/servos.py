"""Six position servos in each of n worlds: a commanded ramp, and horns that follow it with limited
speed and a dead band.

The ramp is the firmware's response to a `ServoCommand`: all six move linearly from their current
ramp positions and arrive together. Servos run open loop, so the motion of a whole control step is
one table. The tendon law limits a servo's force."""

from collections.abc import Sequence
from functools import lru_cache

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

    changing = ("horn", "_start", "_way", "_elapsed", "_duration", "_past")

    def __init__(self, num_worlds: int, dt: float) -> None:
        self._dt = dt
        self.horn = np.zeros((num_worlds, len(SERVOS)))
        self.zero = np.zeros((num_worlds, len(SERVOS)))
        self._start = self.horn.copy()
        self._way = self.horn.copy()
        self._elapsed = self._duration = 1.0  # all worlds move together, or stay where they start
        # Of every servo, although those of a hand are equal: broadcasting costs more than the rest.
        self._reach = self.horn.copy()
        self._dead_band = self.horn.copy()
        self._late = np.zeros(num_worlds, dtype=int)
        # The latest ramp positions, as many as the largest lag in steps.
        self._past = np.zeros((0, num_worlds, len(SERVOS)))

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
        self._reach[index] = [[given.speed * self._dt] for given in settings]
        self._dead_band[index] = [[given.dead_band] for given in settings]
        self._late[index] = [round(given.lag / self._dt) for given in settings]
        missing = self._late.max() - len(self._past)
        if missing > 0:
            self._past = np.concatenate([*[self._start[None]] * missing, self._past])
        self._past[:, index] = self._start[index]

    @property
    def commanded(self) -> Array:
        """Current commanded angles, on their ramps to the targets, shape (n, 6) [rad]."""
        return self._start + min(self._elapsed / self._duration, 1.0) * self._way

    def command(self, servo: Array, duration: float) -> None:
        """Start a move in every world from its current ramp position to angles, shape (n, 6) [rad],
        within a duration [s].
        """
        self._start = self.commanded
        self._way = servo - self._start
        self._elapsed = 0.0
        self._duration = duration

    def advance(self, steps: int) -> tuple[Array, Array]:
        """Advance by physics steps; returns the horns' true angles [rad] and speeds [rad/s], shapes
        (n, steps, 6).
        """
        share, self._elapsed = _shares(self._elapsed, self._duration, self._dt, steps)
        told = self._start + share * self._way  # by step, then by world
        if kept := len(self._past):
            ramp = np.concatenate([self._past, told])
            row = kept + np.arange(steps)[:, None] - self._late
            told = ramp[row, np.arange(len(self.horn))]
            self._past = ramp[-kept:]
        angle = np.empty_like(told)
        moved = np.empty_like(told)
        least = -self._reach
        horn = self.horn
        for there, way, after in zip(told, moved, angle, strict=True):
            error = there - horn
            np.minimum(np.maximum(error, least), self._reach, out=way)
            way[np.abs(error) <= self._dead_band] = 0.0
            horn = np.add(horn, way, out=after)
        self.horn = horn.copy()
        angle += self.zero
        moved /= self._dt
        return angle.swapaxes(0, 1), moved.swapaxes(0, 1)


@lru_cache(maxsize=16)
def _shares(elapsed: float, duration: float, dt: float, steps: int) -> tuple[Array, float]:
    """Shares of a move that are complete at the ends of physics steps, shape (steps, 1, 1), and the
    time at the last one.
    """
    times = np.cumsum([elapsed, *[dt] * steps])[:, None, None]
    return np.minimum(times[1:] / duration, 1.0), float(times[-1, 0, 0])
