"""Hands derived from a given one by scaling its parameters."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model.parameters import Digit, Hand


def scaled_digit(digit: Digit, scale: Mapping[str, ArrayLike]) -> Digit:
    """A copy of a digit with fields multiplied by factors, by field name; radii and path lengths by
    one factor or one for each.

    Raises:
        AttributeError: `Digit` has no such field.
        ParameterError: A scaled number is not finite and positive.
    """
    changed: dict[str, Any] = {}
    for name, factor in scale.items():
        value = getattr(digit, name)
        scaled = (np.asarray(factor) * value).tolist()
        changed[name] = tuple(scaled) if isinstance(value, tuple) else scaled
    return replace(digit, **changed)


def scaled_hand(hand: Hand, scale: Mapping[str, float]) -> Hand:
    """A copy of a hand with fields of every `Digit` multiplied by the factors in `scale`, by field
    name.

    Raises:
        AttributeError: `Digit` has no such field.
        ParameterError: A scaled number is not finite and positive.
    """
    return replace(
        hand, digits={name: scaled_digit(digit, scale) for name, digit in hand.digits.items()}
    )
