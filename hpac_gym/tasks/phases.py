"""The phases of a grasp, and of a pick and place, and the wrist's path through them."""

from dataclasses import dataclass
from functools import lru_cache
from math import inf, pi, sin
from typing import Any

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
        _check_durations(self, (self.close_time, self.lift_time, self.shake_time, self.place_time))
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
            share = turn % 1
            # A windowed sine: to 1, to −1 and back to 0, starting and ending at rest.
            swing = sin(2 * pi * share) * sin(pi * share) ** 2 / _SWING_PEAK
            offset[int(turn)] += self.shake_distance * swing
        return tuple(offset)


@dataclass(frozen=True, slots=True)
class PickPlaceTimetable:
    """Durations of the moves [s], and path of the wrist: sideways to the object, up, across, down,
    and back.

    Raises:
        ValueError: A duration that is not positive.
    """

    reach_time: float = 0.6
    close_time: float = 1.2
    lift_time: float = 0.6
    carry_time: float = 0.8
    lower_time: float = 0.5
    release_time: float = 0.8
    retreat_time: float = 0.6
    rest_time: float = 0.4
    reach: tuple[float, float, float] = (0.04, 0.12, 0.0)
    """Displacement to the object, and reversed at the end, in the world [m]."""
    lift_height: float = 0.10
    """Height of the lift [m]."""
    clearance: float = 0.003
    """Height above the target at which the object is released [m]."""

    def __post_init__(self) -> None:
        _check_durations(self, self.durations)

    @property
    def durations(self) -> tuple[float, ...]:
        """Durations of reach, close, lift, carry, lower, release, retreat and rest [s]."""
        return (
            self.reach_time,
            self.close_time,
            self.lift_time,
            self.carry_time,
            self.lower_time,
            self.release_time,
            self.retreat_time,
            self.rest_time,
        )

    @property
    def ends(self) -> tuple[float, ...]:
        """End times of `durations` [s]."""
        return tuple(np.cumsum(self.durations).tolist())

    def wrist_path(self, times: tuple[float, ...], carry: Array) -> Array:
        """Offset of the wrist in the world at times [s], shape (len(times), 3) [m]: one
        minimum-jerk profile per move.

        Args:
            times: when [s].
            carry: displacement from the object's initial position to the target, in the world,
                shape (3,) [m].
        """
        offset = np.zeros((len(times), 3))
        ends = self.ends
        reach = np.array(self.reach)
        up = np.array([0.0, 0.0, self.lift_height])
        moves = (  # start time [s], duration [s] and displacement, shape (3,) [m]
            (0.0, self.reach_time, reach),
            (ends[1], self.lift_time, up),
            (ends[2], self.carry_time, carry),
            (ends[3], self.lower_time, np.array([0.0, 0.0, self.clearance]) - up),
            (ends[5], self.retreat_time, -reach),
        )
        for begin, duration, way in moves:
            offset += _shares(begin, duration, times)[:, None] * way
        return offset


def _check_durations(timetable: Any, durations: tuple[float, ...]) -> None:
    if not (min(durations) > 0 and sum(durations) < inf):
        raise ValueError(f"durations of {timetable} must be finite and greater than 0 s")


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


_SWING_PEAK = 3**1.5 / 8
"""Maximum of sin 2πs · sin² πs, at s = 1/3."""


@lru_cache(maxsize=64)
def _shares(begin: float, duration: float, times: tuple[float, ...]) -> Array:
    """Completed fractions, at times [s], of a move with a start time [s] and a duration [s]."""
    return np.array([moved((time - begin) / duration) for time in times])
