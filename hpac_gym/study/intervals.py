"""Means with 95 % intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over trials or seeds, and the 95 % interval of Student's t; NaN bounds for a single one."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} [{self.low:.3f}, {self.high:.3f}]"


def mean_of(values: ArrayLike) -> Mean:
    """The mean of independent values, shape (n,)."""
    values = np.asarray(values, dtype=float)
    centre = float(values.mean())
    if len(values) < 2:
        return Mean(centre, float("nan"), float("nan"))
    half = float(stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return Mean(centre, centre - half, centre + half)
