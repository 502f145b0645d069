"""The phases of a grasp and the wrist's path through them."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin

from hpac_gym.sim import Vector

PHASES = ("close", "lift", "shake", "hold")


@dataclass(frozen=True, slots=True)
class Timetable:
    """How long each phase takes, and how far the wrist goes.

    Raises:
        ValueError: A duration that is not positive, or a negative distance.
    """

    close_time: float = 1.2
    lift_time: float = 0.6
    lift_height: float = 0.12
    shake_time: float = 0.9
    shake_distance: float = 0.02
    """Amplitude of the shake: one period of a sine along x, then y, then z, so six directions [m]."""
    hold_time: float = 0.3

    def __post_init__(self) -> None:
        if not min(self.close_time, self.lift_time, self.shake_time, self.hold_time) > 0:
            raise ValueError(f"durations of {self} must be greater than 0 s")
        if not min(self.lift_height, self.shake_distance) >= 0:
            raise ValueError(f"distances of {self} must not be negative")

    @property
    def phases(self) -> tuple[str, ...]:
        """Names, in order."""
        return PHASES

    @property
    def ends(self) -> tuple[float, float, float, float]:
        """When each phase ends [s]."""
        lift = self.close_time + self.lift_time
        shake = lift + self.shake_time
        return self.close_time, lift, shake, shake + self.hold_time

    @property
    def duration(self) -> float:
        """Length of an episode [s]."""
        return self.ends[-1]

    def phase(self, time: float) -> int:
        """Index into `PHASES` of the phase that runs, or begins, at a time [s]; the last one stays."""
        return min(sum(time > end - 1e-9 for end in self.ends), len(PHASES) - 1)

    def wrist_path(self, time: float) -> tuple[Vector, Vector]:
        """Where the wrist is: at rest, in a minimum-jerk lift, in a sine along each axis, at rest.

        Returns:
            Offset [m] and velocity [m/s] in the world.
        """
        offset, velocity = [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
        share = min(max((time - self.close_time) / self.lift_time, 0.0), 1.0)
        offset[2] = self.lift_height * share**3 * (10 - 15 * share + 6 * share**2)
        velocity[2] = self.lift_height * 30 * share**2 * (1 - share) ** 2 / self.lift_time
        turn = 3 * (time - self.ends[1]) / self.shake_time
        if 0 < turn < 3:
            offset[int(turn)] += self.shake_distance * sin(2 * pi * turn)
            velocity[int(turn)] += self.shake_distance * cos(2 * pi * turn) * 6 * pi / self.shake_time
        return tuple(offset), tuple(velocity)
