"""Validation of array arguments; errors give the value, the bound and the unit."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hpac_gym.errors import ParameterError, ShapeError, WorkspaceError

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""Tolerance of every bound, for rounding errors of a value computed to lie on it."""
NORM_TOLERANCE = 1e-3
"""Largest deviation of a given unit vector or quaternion from norm 1, as of four typed digits."""
_REAL = "fiubO"
"""NumPy dtype kinds that can hold real numbers."""


def as_array(value: ArrayLike, size: int, name: str) -> Array:
    """The value as an array of shape (..., size).

    Raises:
        ShapeError: Not numeric, or the last axis has the wrong length.
    """
    try:
        array = np.asarray(value)
        if (
            array.dtype.kind not in _REAL
        ):  # NumPy would convert these to numbers, with a warning at best
            raise TypeError(f"{array.dtype} is not a type of real numbers")
        array = array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError) as error:
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
        raise ShapeError(
            f"{name}[{', '.join(map(str, where))}] = {array[where]} must be a finite number"
        )
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


def as_unit_vector(value: ArrayLike, size: int, name: str) -> Array:
    """The value as one array of shape (size,) of norm 1; off by more than rounding it is divided by
    its norm.

    Raises:
        ShapeError: As from `as_finite_vector`.
        ParameterError: The norm is off by more than `NORM_TOLERANCE`.
    """
    vector = as_finite_vector(value, size, name)
    norm = np.linalg.norm(vector)
    if abs(norm - 1) > NORM_TOLERANCE:
        raise ParameterError(
            f"{name} = {vector.tolist()} of norm {norm:g}: must be 1 to {NORM_TOLERANCE:g}"
        )
    return vector / norm if abs(norm - 1) > TOLERANCE else vector


def as_bounded_array(
    value: ArrayLike,
    lower: Array,
    upper: Array,
    labels: Sequence[str],
    name: str,
    unit: str,
    tolerance: float = TOLERANCE,
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
            f"{name} {labels[column]} = {array[where]:.6g} {unit} is outside [{lower[column]:.6g}, {upper[column]:.6g}] {unit}"
        )
    return array


def plain_list(values: Any) -> Any:
    """Several values, an array's too, as a list of their own types; anything else as it is."""
    return np.asarray(values, dtype=object).tolist()


def read_only(array: Array) -> Array:
    """The array itself, which from now on refuses to be written to."""
    array.setflags(write=False)
    return array
