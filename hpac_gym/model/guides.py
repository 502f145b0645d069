"""The cosine law of a tendon between two guides, in both directions. Eqs. (3)–(5), (7)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hpac_gym.model.checks import Array
from hpac_gym.model.joints import SERVOS

if TYPE_CHECKING:
    from hpac_gym.model.parameters import Hand

_CMC = len(SERVOS) - 1


def chord_from_included(guide_sum: Array, guide_product: Array, included: Array) -> Array:
    """Distance between two guides [m] at an included angle [rad].

    Eq. (3): √(d₁² + d₂² − 2 d₁ d₂ cos φ).

    Args:
        guide_sum: d₁² + d₂² [m²].
        guide_product: 2 d₁ d₂ [m²].
        included: φ [rad]; all three of one shape, or of shapes that broadcast.
    """
    return np.sqrt(guide_sum - guide_product * np.cos(included))


def included_from_chord(guide_sum: Array, guide_product: Array, chord: Array) -> Array:
    """Included angle [rad] of two guides at a given distance [m]: the inverse of `chord_from_included`.

    Eq. (4). An impossible chord gives the nearest angle, 0 or π; callers that must refuse it check first.
    """
    return np.arccos(np.clip((guide_sum - chord**2) / guide_product, -1.0, 1.0))


def unchecked_servo_from_synergy(synergy: Array, hand: Hand) -> Array:
    """Servo angles for driven-joint angles that are known to lie within Table I, shape (..., 6) [rad].

    Eqs. (5), (7), (8) solved for u.
    """
    chord = chord_from_included(hand.guide_sum, hand.guide_product, hand.guide_alpha - synergy[..., :_CMC])
    servo = np.empty_like(synergy)
    servo[..., :_CMC] = (hand.rest_chord - chord) / hand.servo_radius
    servo[..., _CMC] = synergy[..., _CMC] / hand.cmc_gain
    return servo
