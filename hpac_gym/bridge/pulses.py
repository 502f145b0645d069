"""Servo angles and the pulses that stand for them, as the firmware computes them without trims."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.bridge.errors import FrameError
from hpac_gym.bridge.limits import servo_limits
from hpac_gym.bridge.protocol import PULSE
from hpac_gym.model import HPAC, SERVOS, Hand


def pulses_from_servo(servo: ArrayLike, hand: Hand = HPAC) -> np.ndarray:
    """Pulse widths of servo angles, rounded to the nearest nanosecond.

    Args:
        servo: shape (..., 6) [rad].

    Returns:
        Integers, shape (..., 6) [ns].
    """
    centre = np.array([limits.centre_urad for limits in servo_limits(hand)]) * 1e-6
    return np.rint(PULSE["centre_ns"] + (np.asarray(servo, dtype=float) - centre) * PULSE["ns_per_rad"]).astype(np.int64)


def servo_from_pulses(pulses: ArrayLike, hand: Hand = HPAC) -> np.ndarray:
    """Servo angles that a servo without trim takes from these pulses: the inverse of `pulses_from_servo`.

    Args:
        pulses: shape (..., 6) [ns].

    Returns:
        shape (..., 6) [rad].

    Raises:
        FrameError: A width of 0: that servo gets no pulses, so it has no commanded angle.
    """
    pulses = np.asarray(pulses)
    if np.any(pulses == 0):
        silent = [name for name, width in zip(SERVOS, pulses.reshape(-1, len(SERVOS))[-1], strict=True) if width == 0]
        raise FrameError(f"no pulses on {', '.join(silent) or 'some servo'}: the hand is not armed")
    centre = np.array([limits.centre_urad for limits in servo_limits(hand)]) * 1e-6
    return centre + (pulses - PULSE["centre_ns"]) / PULSE["ns_per_rad"]
