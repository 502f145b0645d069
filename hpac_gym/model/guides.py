"""The cosine law of a tendon between two guides, in both directions. Eqs. (3), (4)."""

import numpy as np

from hpac_gym.model.checks import Array


def chord_from_included(
    guide_sum: Array | float, guide_product: Array | float, included: Array | float
) -> Array:
    """Distance between two guides [m] at an included angle [rad].

    Eq. (3): √(d₁² + d₂² − 2 d₁ d₂ cos φ).

    Args:
        guide_sum: d₁² + d₂² [m²].
        guide_product: 2 d₁ d₂ [m²].
        included: φ [rad]; all three of one shape, or of shapes that broadcast.
    """
    return np.sqrt(guide_sum - guide_product * np.cos(included))


def included_from_chord(
    guide_sum: Array | float, guide_product: Array | float, chord: Array
) -> Array:
    """Included angle [rad] of two guides at a given distance [m]: the inverse of
    `chord_from_included`.

    Eq. (4). An impossible chord gives the nearest angle, 0 or π; callers that must refuse it check
    first."""
    cosine = (guide_sum - chord**2) / guide_product
    return np.arccos(np.minimum(np.maximum(cosine, -1.0), 1.0))
