"""Six position servos: a commanded ramp, and horns that follow it with limited speed and a dead band.

The ramp is what the firmware does with a `ServoCommand`: all six move linearly from where their ramp stands, and arrive together.
How hard a servo pulls is limited where it pulls: see `hpac_gym.sim.tendons`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hpac_gym.model import SERVOS, ServoCommand


@dataclass(frozen=True, slots=True)
class ServoSettings:
    """What a servo's data sheet says.

    Raises:
        ValueError: A speed that is not positive, or a negative dead band or lag.
    """

    speed: float = 8.0
    """No-load speed of the horn [rad/s]; chosen: 0.13 s/60°, a common hobby servo."""
    dead_band: float = 2e-3
    """Error that the servo leaves alone [rad]; chosen: 1.3 µs of pulse, a digital servo."""

    lag: float = 0.0
    """From the ramp to the servo's answer: transport, electronics, filtering [s]. In whole physics steps."""

    def __post_init__(self) -> None:
        if not (self.speed > 0 and self.dead_band >= 0 and self.lag >= 0):
            raise ValueError(f"servo speed {self.speed} rad/s must be positive, dead band {self.dead_band} rad not negative, "
                             f"nor lag {self.lag} s")


class Servos:
    """State of the six servos: the ramp that they are told, and where their horns are.

    Attributes:
        horn: where the horns are, by servo [rad].
        velocity: their speed over the last physics step, by servo [rad/s].

    Plain floats: at six servos an array costs more to make than to calculate.
    """

    def __init__(self, settings: ServoSettings = ServoSettings()) -> None:
        self.settings = settings
        self.reset(np.zeros(len(SERVOS)))

    def reset(self, servo: Iterable[float]) -> None:
        """Stand still at given angles, shape (6,) [rad]."""
        self.horn = [float(angle) for angle in servo]
        self.velocity = [0.0] * len(SERVOS)
        self._start, self._way = list(self.horn), [0.0] * len(SERVOS)
        self._elapsed = self._duration = 1.0
        self._first, self._past = list(self.horn), deque[list[float]]()

    @property
    def commanded(self) -> list[float]:
        """Where the ramp stands now, by servo [rad]."""
        share = min(self._elapsed / self._duration, 1.0)
        return [start + share * way for start, way in zip(self._start, self._way, strict=True)]

    def command(self, command: ServoCommand) -> None:
        """Start a move from where the ramp stands."""
        self._start = self.commanded
        self._way = [goal - start for goal, start in zip(command.servo.tolist(), self._start, strict=True)]
        self._elapsed, self._duration = 0.0, command.duration

    def advance(self, dt: float) -> None:
        """Move ramp and horns on by one physics step of `dt` seconds."""
        self._elapsed += dt
        reach, dead_band = self.settings.speed * dt, self.settings.dead_band
        for servo, told in enumerate(self._told(dt)):
            error = told - self.horn[servo]
            step = 0.0 if -dead_band <= error <= dead_band else min(max(error, -reach), reach)
            self.horn[servo] += step
            self.velocity[servo] = step / dt

    def _told(self, dt: float) -> list[float]:
        """Where the ramp stood one lag ago, by servo [rad]."""
        if not self.settings.lag:
            return self.commanded
        self._past.append(self.commanded)
        late = round(self.settings.lag / dt)
        return self._past.popleft() if len(self._past) > late else self._first
