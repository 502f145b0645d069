"""Closures: ways to close the hand, parametrised by eight numbers or more. One decision per episode
instead of sixty.

A closure moves every digit from open to a goal within a given duration, the thumb earlier or later
than the fingers, at a constant CMC angle. With a free wrist it also has a wrist pose, and begins at
a preshape instead of the open hand. It needs only numpy, so that a host with a real hand runs one
without a simulator."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model import SERVO_INDEX, SERVOS
from hpac_gym.settings import check_bounds, setting

OPEN = -1.0
"""Action that opens a digit."""
_THUMB = SERVO_INDEX["thumb_mp"]
_CMC = SERVO_INDEX["thumb_cmc"]
_GOALS = tuple(f"{servo}_goal" for servo in SERVOS)
_WRIST = ("grasp_x", "grasp_y", "grasp_z", "turn_x", "turn_y", "turn_z")
_SHIFT = ("wrist_x", "wrist_y", "wrist_z", "wrist_yaw")
_ACTION: dict[str, Any] = {"bounds": (-1.0, 1.0)}
_TIME: dict[str, Any] = {"bounds": (-math.inf, math.inf), "unit": "control steps"}
_PRESHAPE = tuple(f"{servo}_preshape" for servo in SERVOS)

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Closures:
    """Ranges of the numbers of a closure; −1…1 of a decision spans each range.

    Attributes:
        goal: final action of the thumb and of each finger, and constant action of the CMC.
        duration: of the motion from open to the goals [control steps].
        thumb_delay: delay of the thumb relative to the fingers [control steps].
        begin: start of the closing [control steps]; None means immediately.
        release: time at which the hand opens again [control steps]; None means never. Given if and
            only if `begin` is given.
        wrist: each number of a free wrist's pose. If given, the first action of a closure is its
            preshape, in the range of `goal`, from which all servos move to their goals; None means
            that the action has no wrist pose.
        shift: each of the four numbers by which an open hand's wrist is moved before it closes;
            None means that the action has none. Not with `wrist`.

    Raises:
        ParameterError: A range is not a pair of ordered numbers within its bounds, or ranges
            exclude each other.
    """

    goal: Range = setting((-0.4, 1.0), **_ACTION)
    duration: Range = setting((6.0, 22.0), bounds=(0.0, math.inf), unit="control steps")
    thumb_delay: Range = setting((-8.0, 8.0), **_TIME)
    begin: Range | None = setting(None, **_TIME)
    release: Range | None = setting(None, **_TIME)
    wrist: Range | None = setting(None, **_ACTION)
    shift: Range | None = setting(None, **_ACTION)

    def __post_init__(self) -> None:
        check_bounds(self, "closure range")
        if (self.begin is None) != (self.release is None):
            raise ParameterError(
                f"a closure has both begin {self.begin} and release {self.release}, or neither"
            )
        if self.wrist is not None and self.shift is not None:
            raise ParameterError(
                "a closure places the wrist or shifts it: wrist and shift exclude each other"
            )

    @property
    def _ranges(self) -> dict[str, Range]:
        """The range of each of the closure's numbers, by name, in order."""
        preshape = None if self.wrist is None else self.goal
        kinds = (
            (_GOALS, self.goal),
            (("duration",), self.duration),
            (("thumb_delay",), self.thumb_delay),
            (("begin",), self.begin),
            (("release",), self.release),
            (_WRIST, self.wrist),
            (_PRESHAPE, preshape),
            (_SHIFT, self.shift),
        )
        return {name: given for names, given in kinds if given is not None for name in names}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the closure's numbers, in order."""
        return tuple(self._ranges)

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest value of each number, shape (2, len(names))."""
        return np.array([*self._ranges.values()]).T

    def decisions(self, values: ArrayLike) -> NDArray[np.float64]:
        """The numbers of closures scaled to decisions, −1…1, both of shape (..., len(names))."""
        low, high = self.bounds
        span = np.where(high > low, high - low, 1.0)
        decided: NDArray[np.float64] = 2 * (np.asarray(values) - low) / span - 1
        return decided

    def actions(self, decisions: ArrayLike, steps: ArrayLike) -> NDArray[np.float64]:
        """Actions of n closures at given control steps.

        Args:
            decisions: shape (n, len(names)), −1…1.
            steps: control steps since each decision, shape (n,).

        Returns:
            Shape (n, 6), −1…1; with a wrist's shift, shape (n, 10), with its pose, (n, 12).
        """
        low, high = self.bounds
        values = low + (np.asarray(decisions, dtype=float) + 1) / 2 * (high - low)
        goals = values[:, :6]
        (duration, thumb_delay) = values[:, 6:8].T
        more = values[:, 8:]
        begin, release = more[:, :2].T if self.begin is not None else (0.0, np.inf)
        wrist = more[:, -len(_SHIFT) :] if self.shift is not None else np.zeros((len(values), 0))
        start = np.full(goals.shape, OPEN)
        start[:, _CMC] = goals[:, _CMC]
        if self.wrist is not None:
            begin = begin + 1  # the first action is the preshape itself
            wrist, start = np.split(more[:, -len(_WRIST + _PRESHAPE) :], [len(_WRIST)], axis=1)
        time = np.asarray(steps, dtype=float)
        delay = np.repeat(np.maximum(-thumb_delay, 0.0)[:, None], len(SERVOS), axis=1)
        delay[:, _THUMB] = np.maximum(thumb_delay, 0.0)
        # A duration of 0 is at once, not 0 / 0.
        share = ((time + 1 - begin)[:, None] - delay) / np.maximum(duration, 1e-9)[:, None]
        return np.hstack(
            [start + np.clip(share, 0.0, 1.0) * (time <= release)[:, None] * (goals - start), wrist]
        )
