"""The options that all environments have, checked in one place."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple
from os import PathLike
from typing import Any, Literal, get_args

from hpac_gym.envs.observation import CameraNoise
from hpac_gym.errors import ParameterError
from hpac_gym.model import Hand, load_hand
from hpac_gym.model.checks import as_finite_vector
from hpac_gym.sim import ObjectSpec, SceneSetup

Reward = Literal["dense", "sparse"]
RENDER_MODES = ["rgb_array"]
_SETUP_ARRAYS = {"position": 3, "synergy": 6, "hand_quaternion": 4, "object_quaternion": 4, "target": 3}


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
        ParameterError: A bad hand file, or neither a hand nor a path.
    """
    if isinstance(hand, Hand):
        return hand
    if not isinstance(hand, str | PathLike):
        raise ParameterError(f"hand {hand!r} is neither a Hand nor the path of a hand file")
    return load_hand(hand)


def noise_of(noise: CameraNoise) -> CameraNoise:
    """The noise itself.

    Raises:
        ParameterError: It is none, or a standard deviation is negative or not finite.
    """
    if not isinstance(noise, CameraNoise):
        raise ParameterError(f"noise {noise!r} is not a CameraNoise; CameraNoise(0.0, 0.0, 0.0) is no noise")
    if not all(0 <= deviation < math.inf for deviation in astuple(noise)):
        raise ParameterError(f"standard deviations of {noise} must be finite and at least 0")
    return noise


def reset_option(options: Mapping[str, Any] | None, name: str) -> Any:
    """The only option that an environment's `reset` has, or None.

    Raises:
        ParameterError: Another option is given, or no mapping.
    """
    if not isinstance(options, Mapping | None) or set(options or {}) - {name}:
        raise ParameterError(f"options {options!r} of reset must be None or {{{name!r}: ...}}")
    return (options or {}).get(name)


def setup_of(options: Mapping[str, Any] | None) -> SceneSetup | None:
    """The episode that the options of a `reset` give, or None.

    Raises:
        ParameterError: Another option than "setup", or a setup that is none.
        ShapeError: An array of the setup, or its yaw, has the wrong shape, NaN or infinity.
    """
    setup = reset_option(options, "setup")
    if setup is None:
        return None
    if not (isinstance(setup, SceneSetup) and isinstance(setup.object, ObjectSpec)):
        raise ParameterError(f"option 'setup' must be a SceneSetup with an ObjectSpec, not {setup!r}")
    for name, size in _SETUP_ARRAYS.items():
        if getattr(setup, name) is not None:
            as_finite_vector(getattr(setup, name), size, f"setup {name}")
    as_finite_vector([setup.yaw], 1, "setup yaw")
    return setup
