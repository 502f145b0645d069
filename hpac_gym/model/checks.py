"""Checks of a caller's arrays, with errors that name the value, the bound and the unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpac_gym.errors import ShapeError, WorkspaceError

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""Slack of every bound, for the rounding of a value that was computed to lie on it."""
_REAL = "fiubO"
"""Kinds of arrays that can hold real numbers."""


def as_array(value: ArrayLike, size: int, name: str) -> Array:
    """The value as an array of shape (..., size).

    Raises:
        ShapeError: It is not numeric, or its last axis has another length.
    """
    try:
        array = np.asarray(value)
        if array.dtype.kind not in _REAL:  # which NumPy would make numbers of, with a warning at best
            raise TypeError(f"{array.dtype} is no type of real numbers")
        array = array.astype(float, copy=False)
    except (TypeError, ValueError) as error:
        raise ShapeError(f"{name} must be an array of numbers: {error}") from None
    if array.ndim == 0 or array.shape[-1] != size:
        raise ShapeError(f"{name} must have shape (..., {size}), not {array.shape}")
    return array


def as_finite_array(value: ArrayLike, size: int, name: str) -> Array:
    """The value as an array of shape (..., size) without NaN or infinity.

    Raises:
        ShapeError: Wrong shape, or something that is not a finite number.
    """
    array = as_array(value, size, name)
    finite = np.isfinite(array)
    if not finite.all():
        where = tuple(int(index) for index in np.argwhere(~finite)[0])
        raise ShapeError(f"{name}[{', '.join(map(str, where))}] = {array[where]} must be a finite number")
    return array


def as_finite_vector(value: ArrayLike, size: int, name: str) -> Array:
    """The value as one array of shape (size,) without NaN or infinity.

    Raises:
        ShapeError: Wrong shape, or something that is not a finite number.
    """
    array = as_finite_array(value, size, name)
    if array.ndim != 1:
        raise ShapeError(f"{name} must have shape ({size},), not {array.shape}")
    return array


def as_bounded_array(
    value: ArrayLike, lower: Array, upper: Array, labels: Sequence[str], name: str, unit: str, tolerance: float = TOLERANCE
) -> Array:
    """The value as an array of shape (..., n) that lies within its bounds.

    Raises:
        ShapeError: Wrong shape or not numeric.
        WorkspaceError: NaN, infinite, or out of bounds by more than `tolerance`.
    """
    array = as_array(value, len(labels), name)
    inside = (array >= lower - tolerance) & (array <= upper + tolerance)
    if not inside.all():
        *_, column = where = tuple(np.argwhere(~inside)[0])
        raise WorkspaceError(
            f"{name} {labels[column]} = {array[where]:.6g} {unit} is outside "
            f"[{lower[column]:.6g}, {upper[column]:.6g}] {unit}"
        )
    return array
