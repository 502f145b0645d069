"""A family of hands that differ as prints, tendons and assemblies of one design do, for training and for judging.

All have the palm, the joints and the workspace (Table I) of the nominal hand. A policy is never told which hand it has, and its
commands are computed with the nominal one. Every range is chosen; the comment beside it says after what.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.errors import ParameterError
from hpac_gym.model import DIGITS, FINGERS, HPAC, JOINT_INDEX, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.variation import scaled_digit

SEED = 20_251
"""Both sets are drawn from it, the training hands first."""
SIZES = {"train": 32, "test": 8}
"""Number of hands in each set."""

HAND_SIZE = (0.88, 1.12)
"""Factor of all lengths of a hand: about that of small and large adults' hands over the middle one."""
DIGIT_SIZE = (0.96, 1.04)
"""Of a digit's lengths, beside its hand's."""
SEGMENT_SIZE = (0.97, 1.03)
"""Of each link's length, beside its digit's; the tendon's path past the link grows with it."""
THICKNESS = (0.92, 1.08)
"""Of the radii of a digit's links."""
PULLEY = (0.95, 1.05)
"""Of a digit's pulley radii, all alike, so that the paper's 5:4:5 stays: another print, another tendon's thickness."""
GUIDE = (0.97, 1.03)
"""Of a digit's guide distances d₁, d₂ and of its servo's hub, each of its own."""
TENDON = (0.75, 1.2)
"""Of EA and of the drive's stiffness: tendons wear."""
SPRING = (0.8, 1.2)
"""Of a digit's restoring spring, and of the CMC's stiffness."""
SLACK = (0.0, 3e-3)
"""What each driving tendon has to wind up [m]."""
SERVO_ZERO = 0.06
"""Greatest angle between a servo's true zero and the commanded one [rad]; half a tooth of a horn would be 0.13."""
WEAK = (0.3, 0.7)
"""Share of its stall force with which a weak digit pulls."""
STIFFEST = 1.3
"""Greatest factor of a tendon's stiffness about its joints: the 120 Hz integration of PyBullet is stable up to it."""


@dataclass(frozen=True, slots=True)
class HandVariant:
    """One hand of the family."""

    name: str
    """Such as "train_07"."""
    hand: Hand
    """What its tendons, springs and guides are in truth."""
    geometry: Geometry
    slack: tuple[float, ...]
    """What each driving tendon has to wind up before it pulls, by digit [m]."""
    servo_zero: tuple[float, ...]
    """Where each servo's horn stands when it is commanded to 0 [rad]."""
    strength: tuple[float, ...]
    """Share of its stall force with which each driving tendon pulls, by digit; 0 is a dead digit."""

    def over(self, settings: Any) -> Any:
        """A `hpac_gym.physics.settings.HandSettings` with this hand's slack, servo zero and strength."""
        return replace(settings, slack=self.slack, servo_zero=self.servo_zero, strength=self.strength)


@cache
def hand_set(name: str) -> tuple[HandVariant, ...]:
    """The 32 training hands ("train") or the 8 hands that are held out ("test"), always the same.

    One hand in four has a weak digit, one in eight a dead finger.

    Raises:
        ParameterError: There is no such set.
    """
    if name not in SIZES:
        raise ParameterError(f"hand set {name!r} is not one of {', '.join(SIZES)}")
    first = 0 if name == "train" else SIZES["train"]
    streams = (np.random.default_rng([SEED, first + index]) for index in range(SIZES[name]))
    return tuple(_variant(f"{name}_{index:02}", index, rng) for index, rng in enumerate(streams))


def _variant(name: str, index: int, rng: np.random.Generator) -> HandVariant:
    size, digits, lengths, thickness = rng.uniform(*HAND_SIZE), {}, {}, {}
    for digit in DIGITS:
        changed = None
        while changed is None or not _is_sound(changed, HPAC):  # in one of a few draws a joint would leave Table I
            factors = size * rng.uniform(*DIGIT_SIZE) * rng.uniform(*SEGMENT_SIZE, 3)
            changed = _changed_digit(HPAC.digits[digit], factors, rng)
        digits[digit], lengths[digit], thickness[digit] = changed, factors, rng.uniform(*THICKNESS)
    strength = np.ones(len(DIGITS))
    if index % 4 == 1:
        strength[rng.integers(len(DIGITS))] = rng.uniform(*WEAK)
    elif index % 8 == 3:
        strength[DIGITS.index(FINGERS[rng.integers(len(FINGERS))])] = 0.0
    return HandVariant(
        name,
        replace(HPAC, name=f"H-PAC {name}", digits=digits, cmc_stiffness=HPAC.cmc_stiffness * rng.uniform(*SPRING)),
        scaled_geometry(HPAC_GEOMETRY, lengths, thickness),
        tuple(rng.uniform(*SLACK, len(DIGITS)).tolist()),
        tuple(rng.uniform(-SERVO_ZERO, SERVO_ZERO, len(SERVOS)).tolist()),
        tuple(strength.tolist()),
    )


def _changed_digit(digit: Digit, lengths: Array, rng: np.random.Generator) -> Digit:
    """A digit whose links are so many times as long; the thumb's first link is its metacarpal, which no coupling passes."""
    links = lengths[1:] if digit.name == "thumb" else lengths
    pulley, tendon = rng.uniform(*PULLEY), rng.uniform(*TENDON)
    d1, d2, hub = rng.uniform(*GUIDE, 3)
    numbers = {"d1": d1, "d2": d2, "servo_radius": hub, "joint_radius": pulley, "path_length": links[: len(digit.path_length)]}
    numbers |= {"spring_stiffness": rng.uniform(*SPRING), "tendon_stiffness": tendon, "drive_stiffness": tendon}
    return scaled_digit(digit, numbers)


def _is_sound(digit: Digit, nominal: Hand) -> bool:
    """Whether its joints keep to Table I up to the root's end, and its tendons are not too stiff to be simulated."""
    root, *_ = joints = [JOINT_INDEX[name] for name in digit.joints]
    reached = digit.elastic_ratio * nominal.joint_max[root]
    old = nominal.digits[digit.name]
    stiffer = digit.segment_stiffness / old.segment_stiffness * (digit.joint_radius[0] / old.joint_radius[0]) ** 2
    drive = digit.drive_stiffness / old.drive_stiffness * (min(digit.d1, digit.d2) / min(old.d1, old.d2)) ** 2
    return bool((reached <= nominal.joint_max[joints]).all() and max(*stiffer, drive) <= STIFFEST)


def scaled_geometry(geometry: Geometry, lengths: Mapping[str, Array], thickness: Mapping[str, float]) -> Geometry:
    """A body with other links on the same palm; a link weighs as its length and its cross-section do.

    Args:
        geometry: the body to change.
        lengths: factors of each digit's links, from the palm outwards, shape (3,).
        thickness: factor of the radii of each digit's links.

    Returns:
        The changed body, without opposition postures: those are searched for one body.
    """
    digits = tuple(digit.scaled(lengths[digit.name], thickness[digit.name]) for digit in geometry.digits)
    return replace(geometry, digits=digits, opposition={})
