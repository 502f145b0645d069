"""The options that all environments have, checked in one place."""

from __future__ import annotations

from os import PathLike
from typing import Literal, get_args

from hpac_gym.errors import ParameterError
from hpac_gym.model import Hand, load_hand

Reward = Literal["dense", "sparse"]
RENDER_MODES = ["rgb_array"]


def require_options(reward: str, render_mode: str | None) -> None:
    """Refuse what no environment has.

    Raises:
        ParameterError: An unknown reward or render mode.
    """
    if reward not in get_args(Reward):
        raise ParameterError(f"reward {reward!r} is neither 'dense' nor 'sparse'")
    if render_mode not in (None, *RENDER_MODES):
        raise ParameterError(f"render_mode {render_mode!r} is neither None nor 'rgb_array'")


def hand_of(hand: Hand | str | PathLike[str]) -> Hand:
    """The hand itself, or what its file holds.

    Raises:
        ParameterError: A bad hand file.
    """
    return hand if isinstance(hand, Hand) else load_hand(hand)
