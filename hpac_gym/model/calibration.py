"""What a sweep identifies of one hand beyond the paper's model: zeros of its servos, and friction."""

from dataclasses import dataclass
from math import pi

from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import plain_list
from hpac_gym.model.joints import DIGITS, SERVOS
from hpac_gym.settings import check_bounds, setting


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry friction of a digit's joints, opposing the motion.

    A joint's friction torque is `joint` + `tendon` times the torque of the tendons that load it.

    Raises:
        ParameterError: A number leaves its bounds.
    """

    joint: float = setting(0.0, bounds=(0.0, 1.0), unit="N·m")
    """Friction torque of every joint's bearing, at most about a servo's (chosen) [N·m]."""
    tendon: float = setting(0.0, bounds=(0.0, 0.999))
    """Fraction of the tendons' load that each joint's guides hold back as friction, below 1."""

    def __post_init__(self) -> None:
        check_bounds(self, "friction")


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of one hand beyond the paper's model, identified from a sweep; all zero for an
    uncalibrated hand.

    The paper's maps, Eqs. (1)–(15), do not use it. `hpac_gym.model.settled` does.

    Raises:
        ParameterError: Wrong number of entries, or an angle that is not finite or above half a turn.
    """

    servo_zero: tuple[float, ...] = setting(
        (0.0,) * len(SERVOS), bounds=(-pi, pi), size=len(SERVOS), unit="rad"
    )
    """True angle of each servo's horn when commanded to 0 [rad]."""
    friction: tuple[Friction, ...] = (Friction(),) * len(DIGITS)
    """Friction of each digit."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "servo_zero", plain_list(self.servo_zero))
        object.__setattr__(self, "friction", tuple(self.friction))
        check_bounds(self, "calibration")
        if len(self.friction) != len(DIGITS):
            raise ParameterError(
                f"calibration friction must have {len(DIGITS)} entries, not {len(self.friction)}"
            )
