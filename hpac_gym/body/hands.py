"""A family of hands that vary like different builds of one design, for training and evaluation.

All share the palm, the joints and the workspace (Table I) of the nominal hand. A policy is never
told which hand it controls, and its commands are computed with the nominal hand. Every range is
chosen; the text beside it gives the reason."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.model import DIGITS, FINGERS, HPAC, JOINT_INDEX, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.variation import scaled_digit
from hpac_gym.settings import check_choice

SEED = 20_251
"""Seed of both sets; the training hands are drawn first."""
SIZES = {"train": 32, "test": 8}
"""Number of hands in each set."""

RANGES = {
    # All lengths of a hand: about the range of small to large adult hands, relative to a medium one.
    "hand": (0.88, 1.12),
    # In addition, the lengths of a digit, and each of its links with the tendon path along it.
    "digit": (0.96, 1.04),
    "segment": (0.97, 1.03),
    # The radii of a digit's links.
    "thickness": (0.92, 1.08),
    # A digit's pulley radii together, which keeps the paper's 5:4:5: tolerance of print and tendon.
    "pulley": (0.95, 1.05),
    # A digit's guide distances d₁ and d₂ and its servo's hub radius, each by itself.
    "guide": (0.97, 1.03),
    # EA and the drive stiffness together: tendon wear.
    "tendon": (0.75, 1.2),
    # A digit's spring stiffness and, drawn separately, the CMC stiffness.
    "spring": (0.8, 1.2),
}
"""Scale factors, lowest and highest."""
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
    check_choice("hand set", name, SIZES)
    return tuple(_variant(name, index) for index in range(SIZES[name]))


def _variant(split: str, index: int) -> HandVariant:
    name = f"{split}_{index:02}"
    rng = np.random.default_rng([SEED, index + (SIZES["train"] if split == "test" else 0)])
    size = rng.uniform(*RANGES["hand"])
    digits = {}
    bodies = []
    for body in HPAC_GEOMETRY.digits:
        changed = None
        while changed is None or not _is_sound(changed):  # redraw if a joint would leave Table I
            lengths = size * rng.uniform(*RANGES["digit"]) * rng.uniform(*RANGES["segment"], 3)
            changed = _changed_digit(HPAC.digits[body.name], lengths, rng)
        digits[body.name] = changed
        bodies.append(body.scaled(lengths, rng.uniform(*RANGES["thickness"])))
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
            cmc_stiffness=HPAC.cmc_stiffness * rng.uniform(*RANGES["spring"]),
        ),
        # Opposition postures are searched for one geometry.
        replace(HPAC_GEOMETRY, digits=tuple(bodies), opposition={}),
        tuple(rng.uniform(*SLACK, len(DIGITS)).tolist()),
        tuple(rng.uniform(-SERVO_ZERO, SERVO_ZERO, len(SERVOS)).tolist()),
        tuple(strength.tolist()),
    )


def _changed_digit(digit: Digit, lengths: Array, rng: np.random.Generator) -> Digit:
    """The digit with its link lengths scaled; the thumb's first link is its metacarpal, which no
    coupling passes.
    """
    links = lengths[1:] if digit.name == "thumb" else lengths
    pulley = rng.uniform(*RANGES["pulley"])
    tendon = rng.uniform(*RANGES["tendon"])
    d1, d2, hub = rng.uniform(*RANGES["guide"], 3)
    numbers = {
        "d1": d1,
        "d2": d2,
        "servo_radius": hub,
        "joint_radius": pulley,
        "path_length": links[: len(digit.path_length)],
        "spring_stiffness": rng.uniform(*RANGES["spring"]),
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
