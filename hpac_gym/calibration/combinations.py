"""The parameters of a digit that a free-space sweep can identify: dimensionless combinations,
friction and servo zero.

Angles have no scale of length or force: if all lengths of a digit, or all stiffnesses and
frictions, are multiplied by one factor, no angle changes. Only the combinations below remain. A
hand is reconstructed from them with the base hand's d₁, root radius, k_s and EA, on which the
angles do not depend."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from hpac_gym.model import Digit, Hand
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.checks import Array

TYPICAL_FRICTION = Friction(joint=1e-3, tendon=0.03)
"""Initial friction of the fit: small sealed ball bearings, a braided tendon in polymer guides."""


@dataclass(frozen=True, slots=True)
class SweptDigit:
    """A digit with its friction and its servo's zero."""

    digit: Digit
    friction: Friction = TYPICAL_FRICTION
    servo_zero: float = 0.0
    """Angle of the horn at the command 0 [rad]."""


@dataclass(frozen=True, slots=True)
class Combination:
    """One identifiable number."""

    name: str
    formula: str
    spread: float | None
    """Standard deviation of its logarithm per unit spread of the parameters; None: only its order
    of magnitude is known.
    """
    linear: bool = False
    """Whether the fit uses the number itself, on which the angles depend linearly, instead of its
    logarithm.
    """


def combinations(digit: Digit) -> tuple[Combination, ...]:
    """The combinations of a digit, in the order of the vectors below."""
    parts = [joint.rpartition("_")[2] for joint in digit.joints]
    root = parts[0].upper()
    return (
        Combination("hub", "r/d1", np.sqrt(2)),
        Combination("reach", "d2/d1", np.sqrt(2)),
        Combination("alpha", "alpha", 1.0),
        *(
            Combination(f"{part}_ratio", f"R_{root}/R_{part.upper()}", np.sqrt(2))
            for part in parts[1:]
        ),
        *(
            Combination(f"{part}_strain", f"k_s L_{before.upper()},{part.upper()}/EA", np.sqrt(3))
            for before, part in pairwise(parts)
        ),
        Combination("drive_stretch", f"k_s R_{root}^2/(k_d d1^2)", None, linear=True),
        Combination("friction", f"f/(k_s R_{root}^2)", None),
        Combination("tendon_friction", "share of the load", None),
        Combination("servo_zero", "rad", None, linear=True),
    )


def values(swept: SweptDigit) -> Array:
    """Values of the combinations for a digit; alpha, friction and zero in rad, the others
    dimensionless.
    """
    digit = swept.digit
    friction = swept.friction
    radius = np.array(digit.joint_radius)
    path = np.array(digit.path_length)
    unit = digit.spring_stiffness * radius[0] ** 2
    return np.concatenate(
        [
            [digit.servo_radius / digit.d1, digit.d2 / digit.d1, digit.alpha],
            radius[0] / radius[1:],
            digit.spring_stiffness * path / digit.tendon_stiffness,
            [
                unit / (digit.drive_stiffness * digit.d1**2),
                friction.joint / unit,
                friction.tendon,
                swept.servo_zero,
            ],
        ]
    )


def digit_with(base: Digit, wanted: Array) -> SweptDigit:
    """Digit, friction and zero with the given values; d₁, root radius, k_s and EA are the base
    digit's.
    """
    count = len(base.path_length)
    hub, reach, alpha = wanted[:3]
    ratio = wanted[3 : 3 + count]
    strain = wanted[3 + count : 3 + 2 * count]
    drive, joint_friction, tendon_friction, zero = wanted[-4:]
    root = base.joint_radius[0]
    unit = base.spring_stiffness * root**2
    digit = replace(
        base,
        servo_radius=float(hub * base.d1),
        d2=float(reach * base.d1),
        alpha=float(alpha),
        joint_radius=(root, *(root / ratio).tolist()),
        path_length=tuple((strain * base.tendon_stiffness / base.spring_stiffness).tolist()),
        drive_stiffness=float(unit / (drive * base.d1**2)),
    )
    return SweptDigit(
        digit, Friction(float(joint_friction * unit), float(tendon_friction)), float(zero)
    )


def hand_with(
    hand: Hand,
    swept: Mapping[str, SweptDigit],
    cmc: Sequence[float] | None,
    **changes: Any,
) -> Hand:
    """A hand with other digits, and what else changes.

    Args:
        hand: the hand, whose digits remain where `swept` has none.
        swept: digits with friction and servo zero, by name.
        cmc: g_CMC and the zero of its servo [rad]; None: as of `hand`.
        changes: other fields of the hand.

    Raises:
        ParameterError: The parameters are invalid.
    """
    *zeros, zero = hand.calibration.servo_zero
    parts = zip(hand.digits.items(), hand.calibration.friction, zeros, strict=True)
    digits = {
        name: swept.get(name, SweptDigit(digit, friction, servo_zero))
        for (name, digit), friction, servo_zero in parts
    }
    gain, zero = (hand.cmc_gain, zero) if cmc is None else cmc
    return replace(
        hand,
        digits={name: item.digit for name, item in digits.items()},
        cmc_gain=gain,
        calibration=Calibration(
            (*(item.servo_zero for item in digits.values()), zero),
            tuple(item.friction for item in digits.values()),
        ),
        **changes,
    )
