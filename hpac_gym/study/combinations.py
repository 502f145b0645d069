"""What a free-space sweep can say about a digit: dimensionless combinations of its parameters.

Angles carry no scale of length or force: multiply every length of a digit, or every stiffness and friction, by one factor and
no angle changes. The combinations below are what is left. A hand is made from them by keeping the base hand's d₁, root radius,
k_s and EA, which nothing in the angles depends on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hpac_gym.model import Digit
from hpac_gym.model.checks import Array
from hpac_gym.study.statics import Friction

TYPICAL_FRICTION = 1e-3
"""Joint friction that the search starts from [N·m]: a small ball bearing and its seal."""


@dataclass(frozen=True, slots=True)
class Combination:
    """One number that the data can say something about."""

    name: str
    formula: str
    spread: float
    """Standard deviation of its logarithm for hands whose parameters each spread by one unit."""


def combinations(digit: Digit) -> tuple[Combination, ...]:
    """The combinations of a digit, in the order of the vectors below."""
    parts = [joint.rpartition("_")[2] for joint in digit.joints]
    root = parts[0].upper()
    found = [
        Combination("hub", "r/d1", np.sqrt(2)),
        Combination("reach", "d2/d1", np.sqrt(2)),
        Combination("alpha", "alpha", 1.0),
    ]
    found += [Combination(f"{part}_ratio", f"R_{root}/R_{part.upper()}", np.sqrt(2)) for part in parts[1:]]
    found += [
        Combination(f"{part}_strain", f"k_s L_{before.upper()},{part.upper()}/EA", np.sqrt(3))
        for before, part in pairwise(parts)
    ]
    found.append(Combination("drive_stretch", f"k_s R_{root}^2/(k_d d1^2)", np.sqrt(10)))
    found.append(Combination("friction", f"f/(k_s R_{root}^2)", np.sqrt(6)))
    return tuple(found)


def values(digit: Digit, joint_friction: float) -> Array:
    """The combinations' values for a digit; alpha and friction in rad, the others pure numbers."""
    radius, path = np.array(digit.joint_radius), np.array(digit.path_length)
    unit = digit.spring_stiffness * radius[0] ** 2
    return np.concatenate([
        [digit.servo_radius / digit.d1, digit.d2 / digit.d1, digit.alpha],
        radius[0] / radius[1:],
        digit.spring_stiffness * path / digit.tendon_stiffness,
        [unit / (digit.drive_stiffness * digit.d1**2), joint_friction / unit],
    ])  # fmt: skip


def digit_with(base: Digit, wanted: Array) -> tuple[Digit, Friction]:
    """A digit and a friction that have given values; d₁, root radius, k_s and EA are the base digit's."""
    count = len(base.path_length)
    hub, reach, alpha = wanted[:3]
    ratio, strain = wanted[3 : 3 + count], wanted[3 + count : 3 + 2 * count]
    drive, friction = wanted[-2:]
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
    return digit, Friction(float(friction * unit))
