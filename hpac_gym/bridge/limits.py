"""The servo table on the wire: limits in integer units, taken from the hand's parameters, their
hash, and the pulses of an angle.

Host and firmware compare the hash in the handshake, so that a host drives only a hand with the
limits that it knows."""

import struct
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.bridge.errors import ClippedWarning, FrameError
from hpac_gym.bridge.protocol import ANGLE_UNIT, CONSTANTS, PULSE, VERSION
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, SERVOS, Hand
from hpac_gym.model.checks import Array, as_finite_array

HASHED_PULSE = ("period_ns", "min_ns", "max_ns")
HASHED_CONSTANTS = (
    "angle_tolerance_urad",
    "time_tolerance_us",
    "rate_excess_permille",
    "step_max_ms",
    "relax_permille",
)


@dataclass(frozen=True, slots=True)
class ServoLimits:
    """Limits of one servo, in the units of the firmware."""

    name: str
    min_urad: int
    max_urad: int
    rest_urad: int
    centre_urad: int
    rate_urad_s: int
    ns_per_rad: int
    centre_ns: int


def servo_limits(hand: Hand = HPAC) -> tuple[ServoLimits, ...]:
    """The servo table of a hand, in the order of `SERVOS`.

    Angles are rounded to the wire's step, so that a command for exactly the limit is accepted. Rest
    is 0 rad, or the limit closest to it; the centre pulse corresponds to the middle of the range.

    Raises:
        ParameterError: A range beyond the pulses of a servo, or a rate that rounds to 0.
    """
    step = round(ANGLE_UNIT * 1e6)
    lower = np.rint(hand.servo_min / ANGLE_UNIT).astype(int) * step
    upper = np.rint(hand.servo_max / ANGLE_UNIT).astype(int) * step
    rate = np.rint(np.broadcast_to(hand.servo_rate_limit, len(SERVOS)) * 1e6).astype(int)
    if rate.min() < 1:
        raise ParameterError(
            f"a rate limit of {hand.rate_limit:.3g} rad/s; a board knows none below 1e-06 rad/s"
        )
    reach = (PULSE["max_ns"] - PULSE["min_ns"]) / PULSE["ns_per_rad"]
    span = 1e-6 * (upper - lower)
    if span.max() > reach:
        raise ParameterError(
            f"servo {SERVOS[span.argmax()]}: a range of {span.max():.4g} rad; the pulses of a servo reach {reach:.4g} rad"
        )
    return tuple(
        ServoLimits(
            name=name,
            min_urad=int(lower[i]),
            max_urad=int(upper[i]),
            rest_urad=int(min(max(0, lower[i]), upper[i])),
            centre_urad=int(lower[i] + upper[i]) // 2,
            rate_urad_s=int(rate[i]),
            ns_per_rad=PULSE["ns_per_rad"],
            centre_ns=PULSE["centre_ns"],
        )
        for i, name in enumerate(SERVOS)
    )


class BoardTable:
    """The servo table that a board was flashed for, and the hand that is commanded on it.

    Attributes:
        hand: the hand that is commanded.
        built_for: the hand whose table the board has.
    """

    def __init__(self, hand: Hand) -> None:
        self.hand = hand
        self.built_for = hand
        self._told_clipped = False

    def within(self, servo: Array) -> Array:
        """Servo angles, shape (6,) [rad]; those of a calibrated hand, whose slack and zeros may
        need more than a board allows, are clipped to its range, and the first that is clipped is
        told.
        """
        if not self.hand.is_calibrated:
            return np.asarray(servo)
        clipped = np.clip(servo, self.built_for.servo_min, self.built_for.servo_max)
        beyond = np.abs(clipped - servo) > ANGLE_UNIT / 2
        if beyond.any() and not self._told_clipped:
            self._told_clipped = True
            worst = int(np.argmax(np.abs(clipped - servo)))
            warnings.warn(
                f"servo {SERVOS[worst]}: {servo[worst]:.4f} rad is clipped to {clipped[worst]:.4f} rad, the bound of the "
                f"board, which was flashed for '{self.built_for.name}'",
                ClippedWarning,
                stacklevel=4,
            )
        return clipped


def limits_hash(
    hand: Hand = HPAC, trim_ns: Sequence[int] = (0,) * len(SERVOS), reversed_mask: int = 0
) -> int:
    """CRC-32 of all limits of the hand's output, in the byte order of docs/wire.md.

    Args:
        trim_ns: zero trims of the individual hand, from its DEVICE_HELLO, shape (6,) [ns].
        reversed_mask: bit i is set if servo i is mounted in reverse, from its DEVICE_HELLO.
    """
    numbers = [
        VERSION,
        *(PULSE[name] for name in HASHED_PULSE),
        *(CONSTANTS[name] for name in HASHED_CONSTANTS),
    ]
    for i, servo in enumerate(servo_limits(hand)):
        _, *row = astuple(servo)
        numbers += [*row, trim_ns[i], -1 if reversed_mask >> i & 1 else 1]
    return zlib.crc32(struct.pack(f"<{len(numbers)}i", *numbers))


def pulses_from_servo(servo: ArrayLike, hand: Hand = HPAC) -> np.ndarray:
    """Pulse widths of servo angles, rounded to the nearest nanosecond.

    Args:
        servo: shape (..., 6) [rad].

    Returns:
        Integers, shape (..., 6) [ns].

    Raises:
        ShapeError: Wrong shape, or something that is not a finite number.
    """
    angles = as_finite_array(servo, len(SERVOS), "servo")
    centre = np.array([limits.centre_urad for limits in servo_limits(hand)]) * 1e-6
    return np.rint(PULSE["centre_ns"] + (angles - centre) * PULSE["ns_per_rad"]).astype(np.int64)


def servo_from_pulses(pulses: ArrayLike, hand: Hand = HPAC) -> np.ndarray:
    """Angles that servos without trim take for these pulses: the inverse of `pulses_from_servo`.

    Args:
        pulses: shape (..., 6) [ns].

    Returns:
        shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape, or something that is not a finite number.
        FrameError: A width is 0: a servo without pulses has no commanded angle.
    """
    pulses = as_finite_array(pulses, len(SERVOS), "pulses")
    if np.any(pulses == 0):
        silent = [
            name
            for name, width in zip(SERVOS, pulses.reshape(-1, len(SERVOS))[-1], strict=True)
            if width == 0
        ]
        raise FrameError(f"no pulses on {', '.join(silent) or 'some servo'}: the hand is not armed")
    centre = np.array([limits.centre_urad for limits in servo_limits(hand)]) * 1e-6
    return centre + (pulses - PULSE["centre_ns"]) / PULSE["ns_per_rad"]
