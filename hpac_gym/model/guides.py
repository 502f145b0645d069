"""The tendon guides' inverse, unchecked: what `Hand` and the checked functions of `transmission` share."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hpac_gym.model.checks import Array
from hpac_gym.model.joints import SERVOS

if TYPE_CHECKING:
    from hpac_gym.model.parameters import Hand

_CMC = len(SERVOS) - 1


def unchecked_servo_from_synergy(synergy: Array, hand: Hand) -> Array:
    """Servo angles for angles of the driven joints that are known to lie in Table I, shape (..., 6) [rad].

    Eqs. (5), (7), (8) solved for u.
    """
    chord = np.sqrt(hand.guide_sum - hand.guide_product * np.cos(hand.guide_alpha - synergy[..., :_CMC]))
    servo = np.empty_like(synergy)
    servo[..., :_CMC] = (hand.rest_chord - chord) / hand.servo_radius
    servo[..., _CMC] = synergy[..., _CMC] / hand.cmc_gain
    return servo
