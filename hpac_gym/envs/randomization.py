"""Domain randomization in addition to the task's own draw: hand, object, camera and communication
link.

The policy's model keeps the nominal hand; only the simulated hand changes. Every quantity has its
own random stream, derived from the environment's generator and the quantity's name, so that adding
a quantity does not change the draws of the others."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any
from zlib import crc32

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model import DIGITS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.variation import scaled_digit
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.settings import check_bounds, setting, settings_from
from hpac_gym.tasks import placing

Range = tuple[float, float]
_SAME: Range = (1.0, 1.0)
_NONE: Range = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Randomization:
    """Ranges of quantities that are drawn uniformly, once per episode. The defaults are nominal:
    nothing is drawn.

    Raises:
        ParameterError: A range is not an ordered pair of numbers, or leaves its bounds.
    """

    tendon_stiffness: Range = setting(
        _SAME,
        "factor of EA and of the drive's stiffness, one for each digit",
        bounds=(0.5, 1.3),  # with more the integration of the stiffest mode is unstable (ω dt)
        draws=len(DIGITS),
    )
    slack: Range = setting(
        _NONE,
        "slack of the driving tendons, one for each digit [m]",
        bounds=(0.0, 3e-3),
        draws=len(DIGITS),
    )
    joint_friction: Range = setting(
        _NONE, "Coulomb friction of every joint [N·m]", bounds=(0.0, 0.02)
    )
    skin_friction: Range = setting(
        _SAME, "factor of the friction of the hand's skin", bounds=(0.3, 2.0)
    )
    object_friction: Range = setting(
        _SAME, "factor of the friction of the object's surface", bounds=(0.3, 2.0)
    )
    object_mass: Range = setting(_SAME, "factor of the object's mass", bounds=(0.2, 5.0))
    object_position: Range = setting(
        _NONE,
        "offset of the object along y and along z of the hand frame [m]",
        bounds=(-0.02, 0.02),
        draws=2,
    )
    object_yaw: Range = setting(
        _NONE, "yaw of the object about the vertical [rad]", bounds=(-np.pi, np.pi)
    )
    sensor_noise: Range = setting(
        _SAME,
        "factor of the camera's noise and of the bias of the servos' load",
        bounds=(0.0, 10.0),
    )
    servo_lag: Range = setting(
        _NONE, "delay from a command to the servos' response [s]", bounds=(0.0, 0.15)
    )
    dead_band: Range | None = setting(
        None, "servos' dead band; None is the servo's own [rad]", bounds=(0.0, 0.1)
    )
    dropped_frames: Range = setting(
        _NONE, "share of the commands that never arrive", bounds=(0.0, 0.5)
    )
    late_frames: Range = setting(
        _NONE,
        "share of the commands that arrive late, at any time of their control period",
        bounds=(0.0, 1.0),
    )

    def __post_init__(self) -> None:
        check_bounds(self, "randomization")

    def draw(self, rng: np.random.Generator) -> dict[str, Any]:
        """Values of one episode, by name: a number each, or an array of several; quantities with their
        default range are left out.
        """
        found = {}
        for quantity in fields(self):
            bounds = getattr(self, quantity.name)
            if bounds != quantity.default:
                draws = quantity.metadata.get("draws")
                found[quantity.name] = stream(rng, quantity.name).uniform(*bounds, draws)
        return found


_HAND = {
    "tendon_stiffness": (0.8, 1.2),
    "slack": (0.0, 1e-3),
    "joint_friction": (0.0, 5e-3),
    "skin_friction": (0.8, 1.2),
}
_LINK = {"servo_lag": (0.0, 0.15), "dead_band": (0.0, 0.02), "dropped_frames": (0.0, 0.05)}
_OBJECT = {
    "object_friction": (0.8, 1.2),
    "object_mass": (0.8, 1.25),
    "object_position": (-3e-3, 3e-3),
    "object_yaw": (-0.1, 0.1),
}
PRESETS: Mapping[str, Randomization] = MappingProxyType(
    {
        "nominal": Randomization(),
        "hand": Randomization(**_HAND),
        "link": Randomization(**_LINK),
        "full": Randomization(**_HAND, **_LINK, **_OBJECT, sensor_noise=(0.5, 2.0)),
    }
)
"""Named randomizations: none; the hand's mechanics; the link from host to servo; all of these, and
object and camera.
"""


def randomization(
    given: Randomization | Mapping[str, Sequence[float]] | str | None,
) -> Randomization:
    """Randomization for a value of the option `randomize`.

    Args:
        given: a `Randomization`; the name of a preset; a dict of ranges such as `{"servo_lag": [0,
            0.1]}`, the others nominal; None is "nominal".

    Raises:
        ParameterError: Unknown preset or quantity, or an invalid range.
    """
    if isinstance(given, str) and given in PRESETS:
        return PRESETS[given]
    if not isinstance(given, Randomization | Mapping | None):
        raise ParameterError(
            f"randomize must be a preset ({', '.join(PRESETS)}), Randomization or dict of ranges; got {given!r}"
        )
    return settings_from(Randomization(), given, "randomize")


def stream(rng: np.random.Generator, name: str) -> np.random.Generator:
    """Separate generator for a name, regardless of what `rng` has drawn or spawned."""
    parent = rng.bit_generator.seed_seq
    return np.random.default_rng(
        np.random.SeedSequence(parent.entropy, spawn_key=(*parent.spawn_key, crc32(name.encode())))
    )


def changed_hand(hand: Hand, factors: Array) -> Hand:
    """The hand with each digit's tendon stiffnesses multiplied by a factor, shape (5,)."""
    digits = {
        name: scaled_digit(digit, {"tendon_stiffness": factor, "drive_stiffness": factor})
        for (name, digit), factor in zip(hand.digits.items(), factors, strict=True)
    }
    return replace(hand, digits=digits)


def changed_setup(setup: SceneSetup, values: Mapping[str, Any]) -> SceneSetup:
    """A setup with drawn values applied."""
    if not values:
        return setup
    hand = setup.hand
    settings = setup.hand_settings
    if "tendon_stiffness" in values:
        hand = changed_hand(hand, values["tendon_stiffness"])
    servo = replace(
        settings.servo,
        lag=values.get("servo_lag", settings.servo.lag),
        dead_band=values.get("dead_band", settings.servo.dead_band),
    )
    settings = replace(
        settings,
        servo=servo,
        slack=tuple(values["slack"].tolist()) if "slack" in values else settings.slack,
        joint_friction=values.get("joint_friction", settings.joint_friction),
        contact_friction=settings.contact_friction * values.get("skin_friction", 1.0),
    )
    if setup.object is None:
        return replace(setup, hand=hand, hand_settings=settings)
    spec = replace(
        setup.object,
        mass=setup.object.mass * values.get("object_mass", 1.0),
        friction=setup.object.friction * values.get("object_friction", 1.0),
    )
    offset = np.concatenate([[0.0], values.get("object_position", np.zeros(2))])
    changed = replace(
        setup,
        object=spec,
        position=setup.position + offset,
        yaw=setup.yaw + values.get("object_yaw", 0.0),
        hand=hand,
        hand_settings=settings,
    )
    # A post follows its object by itself, a board does not.
    lies = setup.support is not None and setup.support.half_width == placing.BOARD_HALF_WIDTH
    return placing.on_something(changed, stand=False) if lies else changed
