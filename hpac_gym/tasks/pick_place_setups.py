"""Settings of HPAC-PickPlace: its timetable, sampling ranges and reward weights."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from hpac_gym.model.checks import Array
from hpac_gym.settings import check_bounds, setting
from hpac_gym.tasks.phases import moved

PHASES = ("reach", "close", "lift", "place")
REACH, CLOSE, LIFT, PLACE = range(4)


@dataclass(frozen=True, slots=True)
class PickPlaceTimetable:
    """Durations of the moves [s], and path of the wrist: sideways to the object, up, across, down,
    and back.

    Raises:
        ValueError: A duration that is not positive.
    """

    carry: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Displacement from the object's initial position to the target, in the world [m]."""
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
        if not min(self.durations) > 0:
            raise ValueError(f"durations of {self} must be greater than 0 s")

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

    def wrist_path(self, times: tuple[float, ...]) -> Array:
        """Offset of the wrist in the world at times [s], shape (len(times), 3) [m]: one
        minimum-jerk profile per move.
        """
        offset = np.zeros((len(times), 3))
        ends = self.ends
        reach = np.array(self.reach)
        up = np.array([0.0, 0.0, self.lift_height])
        moves = (  # start time [s], duration [s] and displacement, shape (3,) [m]
            (0.0, self.reach_time, reach),
            (ends[1], self.lift_time, up),
            (ends[2], self.carry_time, np.array(self.carry)),
            (ends[3], self.lower_time, np.array([0.0, 0.0, self.clearance]) - up),
            (ends[5], self.retreat_time, -reach),
        )
        for begin, duration, way in moves:
            offset += _shares(begin, duration, times)[:, None] * way
        return offset


@dataclass(frozen=True, slots=True)
class PickPlaceWeights:
    """Weights of the dense reward terms."""

    thumb: float = 0.1
    finger: float = 0.05
    opposed: float = 0.2
    push: float = -0.3
    carry: float = 0.5
    effort: float = -0.01
    success: float = 20.0
    failure: float = -5.0
    place: float = 0.5
    release: float = 0.5


@dataclass(frozen=True, slots=True)
class PickPlaceConfig:
    """Uniform sampling ranges of an episode, success criteria, and reward weights.

    Raises:
        ParameterError: A number or a range leaves its bounds.
    """

    radius: tuple[float, float] = setting(
        (0.020, 0.028), "radius of a cylinder, half-width of a box [m]", bounds=(0.002, 0.06)
    )
    half_height: tuple[float, float] = setting(
        (0.068, 0.080),
        "half-height, tall enough for the hand to clear the object's support [m]",
        bounds=(0.005, 0.15),
    )
    mass: tuple[float, float] = setting((0.05, 0.20), "mass of the object [kg]", bounds=(1e-3, 2.0))
    friction: tuple[float, float] = setting(
        (0.6, 1.0),
        "Coulomb coefficient of the object's surface; the hand's skin multiplies it by 0.9",
        bounds=(0.05, 3.0),
    )
    gap: tuple[float, float] = setting(
        (0.006, 0.015),
        "distance from the palm to the object, once the wrist has reached it [m]",
        bounds=(0.0, 0.1),
    )
    towards_thumb: tuple[float, float] = setting(
        (-0.005, 0.010),
        "place of the object's centre along y of the hand frame [m]",
        bounds=(-0.1, 0.1),
    )
    beyond_wrist: tuple[float, float] = setting(
        (0.105, 0.125),
        "place of the object's centre along z of the hand frame, once the wrist has reached it [m]",
        bounds=(0.02, 0.25),
    )
    carry_forward: tuple[float, float] = setting(
        (-0.04, 0.08), "target offset along the fingers [m]", bounds=(-0.3, 0.3)
    )
    carry_aside: tuple[float, float] = setting(
        (0.16, 0.24), "target offset along the palm's normal [m]", bounds=(0.07, 0.4)
    )
    thumb_preshape: float = setting(
        1.2, "initial CMC, at which the thumb opposes the fingers [rad]", bounds=(0.0, 1.57)
    )
    drop_distance: float = setting(
        0.06,
        "displacement from its intended place beyond which an object is dropped [m]",
        bounds=(5e-3, 1.0),
    )
    tolerance: float = setting(
        0.03, "largest horizontal distance from the target [m]", bounds=(1e-3, 0.2)
    )
    upright: float = setting(
        0.05, "largest tilt of an object that stands [rad]", bounds=(1e-3, 1.57)
    )
    timetable: PickPlaceTimetable = field(default_factory=PickPlaceTimetable)
    weights: PickPlaceWeights = field(default_factory=PickPlaceWeights)

    def __post_init__(self) -> None:
        check_bounds(self, "config")


@lru_cache(maxsize=64)
def _shares(begin: float, duration: float, times: tuple[float, ...]) -> Array:
    """Completed fractions, at times [s], of a move with a start time [s] and a duration [s]."""
    return np.array([moved((time - begin) / duration) for time in times])
