"""Policies that move the hand by increments, and remember what they saw last: closed loops.

It needs only numpy, so that a host with a real hand runs one without a simulator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.settings import check_bounds, setting

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class Recent:
    """What n episodes have seen and done so far.

    Attributes:
        action: where each hand has been moved to, shape (n, 6), −1…1.
        step: control steps since its episode began, shape (n, 1).
        early: mean of its first observations, shape (n, k).
        last: its last ones, the newest at the end, shape (n, m, k).
    """

    action: Array
    step: Array
    early: Array
    last: Array


@dataclass(frozen=True, slots=True)
class Increments:
    """How such a policy moves the hand, and what it is shown: the mean of the first observations, as
    a reading of the untouched hand, then some of the last ones, the newest at the end.

    Attributes:
        start: action at the start posture, −1…1.
        largest: largest change of the action in a control step. A decision's entry d makes the
            change d·|d| times that, so that small changes are as easy to find as large ones.
        frames: number of last observations.
        apart: control steps between them.
        first: number of first observations in the mean.

    Raises:
        ParameterError: There are not six numbers of each kind, or one is out of its range.
    """

    start: tuple[float, ...] = setting(bounds=(-2.0, 2.0), size=6)
    largest: tuple[float, ...] = setting(bounds=(-2.0, 2.0), size=6)
    frames: int = 3
    apart: int = 2
    first: int = 11

    def __post_init__(self) -> None:
        check_bounds(self, "increments")
        for name in ("frames", "apart", "first"):
            if not (type(value := getattr(self, name)) is int and value >= 1):
                raise ParameterError(
                    f"increments {name} = {value!r} must be a whole number from 1 on"
                )

    def begin(self, seen: Array) -> Recent:
        """The beginning of n episodes, from their first observations, shape (n, k)."""
        count = len(seen)
        last = np.repeat(seen[:, None], (self.frames - 1) * self.apart + 1, axis=1)
        return Recent(np.tile(self.start, (count, 1)), np.zeros((count, 1), int), seen.copy(), last)

    def see(self, recent: Recent, seen: Array) -> Recent:
        """Their next observations, shape (n, k)."""
        step = recent.step + 1
        mean = recent.early + (seen - recent.early) / (step + 1)
        early = np.where(step < self.first, mean, recent.early).astype(seen.dtype)
        last = np.concatenate([recent.last[:, 1:], seen[:, None]], axis=1)
        return Recent(recent.action, step, early, last)

    def shown(self, recent: Recent) -> Array:
        """What the policy decides on, shape (n, (1 + frames)·k)."""
        frames = np.concatenate([recent.early[:, None], recent.last[:, :: self.apart]], axis=1)
        return frames.reshape(len(frames), -1)

    def move(self, recent: Recent, decisions: Array) -> Recent:
        """Carry out decisions, shape (n, 6), −1…1; the result's `action` is that of the hand."""
        moved = recent.action + decisions * np.abs(decisions) * np.array(self.largest)
        return Recent(np.clip(moved, -1.0, 1.0), recent.step, recent.early, recent.last)

    def decisions(self, changes: Array) -> Array:
        """Decisions that make these changes of the action, shape (n, 6), as far as they are allowed."""
        share = np.clip(changes / np.array(self.largest), -1.0, 1.0)
        decided: Array = np.sign(share) * np.sqrt(np.abs(share))
        return decided
