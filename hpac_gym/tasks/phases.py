"""The phases of a grasp, and of a pick and place, and the wrist's path through them."""

from dataclasses import dataclass
from functools import lru_cache, partial
from math import inf, pi, sin

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.model.command import minimum_jerk
from hpac_gym.settings import check_bounds, setting
from hpac_gym.tasks.grip import MAX_SLIP

CONTROL_HZ = 20
"""Commands per second [Hz]."""
PHASES = ("close", "lift", "shake", "place")
_duration = partial(setting, bounds=(0.0, inf), above=True, unit="s")


@dataclass(frozen=True, slots=True)
class Timetable:
    """Durations of the phases [s], and distances of the wrist's motion [m].

    Raises:
        ParameterError: A duration that is not positive, a negative distance, or a clearance beyond
            the lift.
    """

    close_time: float = _duration(1.2)
    lift_time: float = _duration(0.6)
    lift_height: float = setting(0.12, bounds=(0.0, inf), unit="m")
    shake_time: float = _duration(0.9)
    shake_distance: float = setting(
        0.02,
        "amplitude of the shake along x, then y, then z, so in six directions [m]",
        bounds=(0.0, inf),
    )
    place_time: float = _duration(0.5)
    clearance: float = setting(
        MAX_SLIP,
        "final height of the wrist above its start, so that a held object does not touch its support at the end [m]",
        bounds=(0.0, inf),
    )

    def __post_init__(self) -> None:
        check_bounds(self, "timetable")
        if self.clearance > self.lift_height:
            raise ParameterError(
                f"timetable clearance = {self.clearance} m must be at most lift_height = {self.lift_height} m"
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
        ParameterError: A duration that is not positive, or a height that is negative or not finite.
    """

    reach_time: float = _duration(0.6)
    close_time: float = _duration(1.2)
    lift_time: float = _duration(0.6)
    carry_time: float = _duration(0.8)
    lower_time: float = _duration(0.5)
    release_time: float = _duration(0.8)
    retreat_time: float = _duration(0.6)
    rest_time: float = _duration(0.4)
    reach: tuple[float, float, float] = setting(
        (0.04, 0.12, 0.0), bounds=(-inf, inf), size=3, unit="m"
    )
    """Displacement to the object, and reversed at the end, in the world [m]."""
    lift_height: float = setting(0.10, bounds=(0.0, inf), unit="m")
    """Height of the lift [m]."""
    clearance: float = setting(0.003, bounds=(0.0, inf), unit="m")
    """Height above the target at which the object is released [m]."""

    def __post_init__(self) -> None:
        check_bounds(self, "timetable")

    @property
    def ends(self) -> tuple[float, ...]:
        """End times of reach, close, lift, carry, lower, release, retreat and rest [s]."""
        durations = (
            self.reach_time,
            self.close_time,
            self.lift_time,
            self.carry_time,
            self.lower_time,
            self.release_time,
            self.retreat_time,
            self.rest_time,
        )
        return tuple(np.cumsum(durations).tolist())

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


@lru_cache(maxsize=16)
def wrist_table(timetable: Timetable, times: tuple[float, ...]) -> Array:
    """`Timetable.wrist_offset` at times [s], shape (len(times), 3) [m]."""
    return np.array([timetable.wrist_offset(time) for time in times])


@lru_cache(maxsize=64)
def phase_limits(ends: tuple[float, ...]) -> Array:
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
