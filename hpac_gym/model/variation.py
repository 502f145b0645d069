"""Hands that differ from a given one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from hpac_gym.model.parameters import Hand


def scaled_hand(hand: Hand, scale: Mapping[str, float]) -> Hand:
    """The same hand with some numbers of every digit multiplied, by field name of `Digit`.

    Raises:
        AttributeError: `Digit` has no such field.
        ParameterError: A number is then not finite and positive.
    """
    digits = {}
    for name, digit in hand.digits.items():
        changed = {}
        for field, factor in scale.items():
            value = getattr(digit, field)
            changed[field] = tuple(factor * x for x in value) if isinstance(value, tuple) else factor * value
        digits[name] = replace(digit, **changed)
    return replace(hand, digits=digits)
