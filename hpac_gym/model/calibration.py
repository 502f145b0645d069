"""What a sweep identifies of one hand beyond the paper's model: zeros of its servos, and friction."""

from dataclasses import dataclass

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model.joints import DIGITS, SERVOS


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry friction of a digit's joints, opposing the motion.

    A joint's friction torque is `joint` + `tendon` times the torque of the tendons that load it.

    Raises:
        ParameterError: A negative value, or `tendon` not below 1.
    """

    joint: float = 0.0
    """Friction torque of every joint's bearing [N·m]."""
    tendon: float = 0.0
    """Fraction of the tendons' load that each joint's guides hold back as friction."""

    def __post_init__(self) -> None:
        if not (0 <= self.joint < np.inf and 0 <= self.tendon < 1):
            raise ParameterError(
                f"friction: joint = {self.joint} N m must be finite and not negative, tendon = {self.tendon} a share in [0, 1)"
            )


@dataclass(frozen=True, slots=True)
class Calibration:
    """Calibration of one hand beyond the paper's model, identified from a sweep; all zero for an
    uncalibrated hand.

    The paper's maps, Eqs. (1)–(15), do not use it. `hpac_gym.model.settled` does.

    Raises:
        ParameterError: Wrong number of entries, or an angle that is not finite.
    """

    servo_zero: tuple[float, ...] = (0.0,) * len(SERVOS)
    """True angle of each servo's horn when commanded to 0 [rad]."""
    friction: tuple[Friction, ...] = (Friction(),) * len(DIGITS)
    """Friction of each digit."""

    def __post_init__(self) -> None:
        for name, length in (("servo_zero", len(SERVOS)), ("friction", len(DIGITS))):
            given = tuple(getattr(self, name))  # of a list or an array, too
            object.__setattr__(self, name, given)
            if len(given) != length:
                raise ParameterError(
                    f"calibration: {name} must have {length} entries, not {len(given)}"
                )
        if not np.isfinite(self.servo_zero).all():
            raise ParameterError(
                f"calibration: servo_zero = {list(self.servo_zero)} rad must be finite"
            )
