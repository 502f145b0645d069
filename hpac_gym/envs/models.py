"""The model with which an episode's hand is commanded and observed, where the option `model` names
one.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from hpac_gym.envs.options import CALIBRATED
from hpac_gym.model import DIGITS, HPAC, Hand, load_hand
from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.physics.engine import SceneSetup

FILES = Path(__file__).parents[1] / "body" / "data" / "calibrated"
"""Hand files of the held-out hands, which `python -m experiments.held_out` makes. The hand with a
dead finger has none, since `hpac calibrate` refuses it: it keeps the nominal numbers.
"""


def model_of(name: str, setup: SceneSetup) -> Hand:
    """The model of an episode's hand.

    Args:
        name: "hand" or "calibrated", as the option `model`.
        setup: the episode.

    """
    return _calibrated(setup.hand.name) if name == CALIBRATED else exact_model(setup)


def exact_model(setup: SceneSetup) -> Hand:
    """A hand file with the true numbers of a simulated hand: slack is a part of the servo's zero,
    since it is wound up before the tendon pulls.
    """
    settings = setup.hand_settings
    hubs = [digit.servo_radius for digit in setup.hand.digits.values()]
    wound = [slack / hub for slack, hub in zip(settings.slack, hubs, strict=True)]
    zero = np.subtract(settings.servo_zero, [*wound, 0.0]).tolist()
    friction = Friction(settings.joint_friction, settings.tendon_friction)
    return replace(setup.hand, calibration=Calibration(tuple(zero), (friction,) * len(DIGITS)))


@cache
def _calibrated(name: str) -> Hand:
    path = FILES / f"{name.removeprefix('H-PAC ')}.toml"
    return load_hand(path) if path.exists() else HPAC
