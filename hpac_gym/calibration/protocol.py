"""The protocol of a servo sweep, of a simulated hand and of a real one."""

from dataclasses import dataclass

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, SERVO_INDEX, SERVOS, Hand
from hpac_gym.model.checks import Array

THUMB_CLEAR = 1.2
"""CMC angle at which the thumb can flex over its whole range without touching fingers or palm
[rad].
"""
CLEARED = "thumb_mp"
"""Servo during whose sweep the thumb's CMC holds `THUMB_CLEAR`, also at rest."""


def rest_pose(swept: str, hand: Hand = HPAC) -> Array:
    """Initial servo angles of a sweep: open, with the thumb clear of the index if it is swept,
    shape (6,) [rad].
    """
    pose = np.zeros(len(SERVOS))
    if swept == CLEARED:
        pose[SERVO_INDEX["thumb_cmc"]] = THUMB_CLEAR
    return np.clip(pose, hand.servo_min, hand.servo_max)


@dataclass(frozen=True, slots=True)
class Protocol:
    """Protocol of a servo sweep: rest, K points in sequence, back to rest.

    Raises:
        ParameterError: There are fewer than two points, the hold leaves no time to move, or the
            rest is negative.
    """

    points: int = 31
    """Number of points K over the servo's admissible range, including both ends."""
    seconds_per_point: float = 1.5
    hold: float = 0.5
    """Final part of a point, in which the servo is stationary and samples count [s]."""
    rest: float = 2.0
    """Duration of the rest before and after, with a slack tendon and the digit against its stops
    [s].
    """
    both_directions: bool = False
    """Whether points are also taken in extension, at the same angles."""

    def __post_init__(self) -> None:
        if not (isinstance(self.points, int) and self.points >= 2):
            raise ParameterError(
                f"protocol: points = {self.points!r} must be a whole number of at least 2"
            )
        if not (0 < self.hold < self.seconds_per_point and self.rest >= 0):
            raise ParameterError(
                f"protocol: hold = {self.hold} s must lie between 0 s and seconds_per_point = {self.seconds_per_point} s, "
                f"and rest = {self.rest} s not be negative"
            )
