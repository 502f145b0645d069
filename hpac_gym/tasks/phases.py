"""The phases of a grasp and the wrist's path through them."""

from dataclasses import dataclass
from functools import lru_cache
from math import pi, sin

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model.checks import Array
from hpac_gym.model.command import minimum_jerk
from hpac_gym.tasks.grip import MAX_SLIP

CONTROL_HZ = 20
"""Commands per second [Hz]."""
PHASES = ("close", "lift", "shake", "place")


@dataclass(frozen=True, slots=True)
class Timetable:
    """Durations of the phases [s], and distances of the wrist's motion [m].

    Raises:
        ValueError: A duration that is not positive, or a negative distance.
    """

    close_time: float = 1.2
    lift_time: float = 0.6
    lift_height: float = 0.12
    shake_time: float = 0.9
    shake_distance: float = 0.02
    """Amplitude of the shake along x, then y, then z, so in six directions [m]."""
    place_time: float = 0.5
    clearance: float = MAX_SLIP
    """Final height of the wrist above its start, so that a held object does not touch its support
    at the end [m].
    """

    def __post_init__(self) -> None:
        if not min(self.close_time, self.lift_time, self.shake_time, self.place_time) > 0:
            raise ValueError(f"durations of {self} must be greater than 0 s")
        if not (self.shake_distance >= 0 and 0 <= self.clearance <= self.lift_height):
            raise ValueError(
                f"distances of {self} must not be negative, nor the clearance beyond the lift"
            )

    @property
    def ends(self) -> tuple[float, float, float, float]:
        """End time of each phase [s]."""
        lift = self.close_time + self.lift_time
        shake = lift + self.shake_time
        return self.close_time, lift, shake, shake + self.place_time

    def wrist_offset(self, time: float) -> tuple[float, float, float]:
        """Offset of the wrist in the world [m]: at rest, up, to and fro along each axis, down; with
        continuous velocity.
        """
        close, lift, shake, _ = self.ends
        offset = [0.0, 0.0, 0.0]
        offset[2] = self.lift_height * moved((time - close) / self.lift_time)
        offset[2] -= (self.lift_height - self.clearance) * moved((time - shake) / self.place_time)
        turn = 3 * (time - lift) / self.shake_time
        if 0 < turn < 3:
            offset[int(turn)] += self.shake_distance * _swing(turn % 1)
        return tuple(offset)


@lru_cache(maxsize=16)
def wrist_table(timetable: Timetable, times: tuple[float, ...]) -> Array:
    """`Timetable.wrist_offset` at times [s], shape (len(times), 3) [m]."""
    return np.array([timetable.wrist_offset(time) for time in times])


def phase_at(time: Array, ends: tuple[float, ...]) -> NDArray[np.int_]:
    """Index of the phase that is running or begins at times [s], given the phases' end times [s];
    the last phase stays.
    """
    return _limits(ends).searchsorted(time)


@lru_cache(maxsize=64)
def _limits(ends: tuple[float, ...]) -> Array:
    """End times of all phases but the last, in ascending order, which rounding may miss by 1e-9
    [s].
    """
    return np.array(ends[:-1]) - 1e-9


def moved(share: float) -> float:
    """Fraction of a minimum-jerk move that is complete after a fraction of its duration; 0 before
    and 1 after the move.
    """
    return minimum_jerk(min(max(share, 0.0), 1.0))


def _swing(share: float) -> float:
    """Windowed sine at a fraction of its duration: to 1, to −1 and back to 0, starting and ending
    at rest.
    """
    return sin(2 * pi * share) * sin(pi * share) ** 2 / _SWING_PEAK


_SWING_PEAK = 3**1.5 / 8
"""Maximum of sin 2πs · sin² πs, at s = 1/3."""
