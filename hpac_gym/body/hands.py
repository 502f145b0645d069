"""A family of hands that vary like different builds of one design, for training and evaluation.

All share the palm, the joints and the workspace (Table I) of the nominal hand. A policy is never
told which hand it controls, and its commands are computed with the nominal hand. Every range is
chosen; the text below it gives the reason."""

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
"""Seed of both sets; the training hands are drawn first."""
SIZES = {"train": 32, "test": 8}
"""Number of hands in each set."""

HAND_SIZE = (0.88, 1.12)
"""Scale factor of all lengths of a hand: about the range of small to large adult hands, relative to
a medium one.
"""
DIGIT_SIZE = (0.96, 1.04)
"""Additional scale factor of a digit's lengths."""
SEGMENT_SIZE = (0.97, 1.03)
"""Additional scale factor of each link's length; the tendon path along the link scales with it."""
THICKNESS = (0.92, 1.08)
"""Scale factor of the radii of a digit's links."""
PULLEY = (0.95, 1.05)
"""Common scale factor of a digit's pulley radii, which keeps the paper's 5:4:5: tolerance of print
and tendon diameter.
"""
GUIDE = (0.97, 1.03)
"""Scale factors of a digit's guide distances d₁, d₂ and of its servo's hub radius, drawn
independently.
"""
TENDON = (0.75, 1.2)
"""Common scale factor of EA and of the drive stiffness: tendon wear."""
SPRING = (0.8, 1.2)
"""Scale factor of a digit's spring stiffness and, drawn separately, of the CMC stiffness."""
SLACK = (0.0, 3e-3)
"""Slack of each driving tendon [m]."""
SERVO_ZERO = 0.06
"""Largest offset of a servo's true zero from the commanded one [rad]; half a spline tooth of a horn
would be 0.13.
"""
WEAK = (0.3, 0.7)
"""Fraction of its stall force that a weak digit can exert."""
STIFFEST = 1.3
"""Largest scale factor of a tendon's stiffness about its joints for which PyBullet's 120 Hz
integration is stable.
"""


@dataclass(frozen=True, slots=True)
class HandVariant:
    """One hand of the family."""

    name: str
    """Name of the hand, such as "train_07"."""
    hand: Hand
    """True parameters of its tendons, springs and guides."""
    geometry: Geometry
    slack: tuple[float, ...]
    """Slack that each driving tendon winds up before it pulls, by digit [m]."""
    servo_zero: tuple[float, ...]
    """True angle of each servo's horn when commanded to 0 [rad]."""
    strength: tuple[float, ...]
    """Fraction of its stall force that each driving tendon can exert, by digit; 0 is a dead digit.
    """

    def over(self, settings: Any) -> Any:
        """The given `hpac_gym.physics.settings.HandSettings` with this hand's slack, servo zeros
        and strength.
        """
        return replace(
            settings, slack=self.slack, servo_zero=self.servo_zero, strength=self.strength
        )


@cache
def hand_set(name: str) -> tuple[HandVariant, ...]:
    """The 32 training hands ("train") or the 8 held-out hands ("test"); every call returns the same
    hands.

    One hand in four has a weak digit, one in eight a dead finger.

    Raises:
        ParameterError: `name` is not one of `SIZES`.
    """
    if name not in SIZES:
        raise ParameterError(f"hand set {name!r} is not one of {', '.join(SIZES)}")
    first = 0 if name == "train" else SIZES["train"]
    streams = (np.random.default_rng([SEED, first + index]) for index in range(SIZES[name]))
    return tuple(_variant(f"{name}_{index:02}", index, rng) for index, rng in enumerate(streams))


def _variant(name: str, index: int, rng: np.random.Generator) -> HandVariant:
    size = rng.uniform(*HAND_SIZE)
    digits = {}
    lengths = {}
    thickness = {}
    for digit in DIGITS:
        changed = None
        while changed is None or not _is_sound(changed):  # redraw if a joint would leave Table I
            factors = size * rng.uniform(*DIGIT_SIZE) * rng.uniform(*SEGMENT_SIZE, 3)
            changed = _changed_digit(HPAC.digits[digit], factors, rng)
        digits[digit] = changed
        lengths[digit] = factors
        thickness[digit] = rng.uniform(*THICKNESS)
    strength = np.ones(len(DIGITS))
    if index % 4 == 1:
        strength[rng.integers(len(DIGITS))] = rng.uniform(*WEAK)
    elif index % 8 == 3:
        strength[DIGITS.index(FINGERS[rng.integers(len(FINGERS))])] = 0.0
    return HandVariant(
        name,
        replace(
            HPAC,
            name=f"H-PAC {name}",
            digits=digits,
            cmc_stiffness=HPAC.cmc_stiffness * rng.uniform(*SPRING),
        ),
        scaled_geometry(HPAC_GEOMETRY, lengths, thickness),
        tuple(rng.uniform(*SLACK, len(DIGITS)).tolist()),
        tuple(rng.uniform(-SERVO_ZERO, SERVO_ZERO, len(SERVOS)).tolist()),
        tuple(strength.tolist()),
    )


def _changed_digit(digit: Digit, lengths: Array, rng: np.random.Generator) -> Digit:
    """The digit with its link lengths scaled; the thumb's first link is its metacarpal, which no
    coupling passes.
    """
    links = lengths[1:] if digit.name == "thumb" else lengths
    pulley = rng.uniform(*PULLEY)
    tendon = rng.uniform(*TENDON)
    d1, d2, hub = rng.uniform(*GUIDE, 3)
    numbers = {
        "d1": d1,
        "d2": d2,
        "servo_radius": hub,
        "joint_radius": pulley,
        "path_length": links[: len(digit.path_length)],
    }
    numbers |= {
        "spring_stiffness": rng.uniform(*SPRING),
        "tendon_stiffness": tendon,
        "drive_stiffness": tendon,
    }
    return scaled_digit(digit, numbers)


def _is_sound(digit: Digit) -> bool:
    """True if the joints stay within Table I over the root joint's range and no tendon is too stiff
    to be simulated.
    """
    root, *_ = joints = [JOINT_INDEX[name] for name in digit.joints]
    reached = digit.elastic_ratio * HPAC.joint_max[root]
    old = HPAC.digits[digit.name]
    stiffer = (
        digit.segment_stiffness
        / old.segment_stiffness
        * (digit.joint_radius[0] / old.joint_radius[0]) ** 2
    )
    drive = (
        digit.drive_stiffness
        / old.drive_stiffness
        * (min(digit.d1, digit.d2) / min(old.d1, old.d2)) ** 2
    )
    return bool((reached <= HPAC.joint_max[joints]).all() and max(*stiffer, drive) <= STIFFEST)


def scaled_geometry(
    geometry: Geometry, lengths: Mapping[str, Array], thickness: Mapping[str, float]
) -> Geometry:
    """A geometry with scaled links on the same palm; a link's mass scales with its length and
    cross-section.

    Args:
        geometry: the geometry to scale.
        lengths: scale factors of each digit's link lengths, from the palm outwards, shape (3,).
        thickness: scale factor of each digit's link radii.

    Returns:
        The scaled geometry, without opposition postures, which are searched for one geometry.
    """
    digits = tuple(
        digit.scaled(lengths[digit.name], thickness[digit.name]) for digit in geometry.digits
    )
    return replace(geometry, digits=digits, opposition={})
