"""A driving tendon: from a servo's hub, through two guides, to a digit's root joint.

Plain floats, since each one is asked once a physics step: an array costs more to make than a tension to calculate.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin, sqrt

from hpac_gym.model import JOINT_INDEX, Digit


@dataclass(frozen=True, slots=True)
class Drive:
    """Stretch ``r u − (L₀ − chord(q))``; it pulls, never pushes, and never harder than the servo can."""

    joint: int
    """Index of the root joint."""
    alpha: float
    """Included angle between the guides at rest [rad]."""
    squares: float
    """d₁² + d₂² [m²]."""
    product: float
    """2 d₁ d₂ [m²]."""
    servo_radius: float
    """r [m]."""
    length: float
    """Chord at which the tendon is taut while the servo is at zero: L₀ and the slack [m]."""
    stiffness: float
    """[N/m]"""
    limit: float
    """What the servo can pull [N]."""
    viscosity: float = 0.0
    """Of the stretch's rate [N·s/m]."""
    brake: float = 0.0
    """The same, of a slack tendon against flexion that is faster than the servo's [N·s/m]."""

    @classmethod
    def of(cls, digit: Digit, slack: float = 0.0) -> Drive:
        """The undamped drive of a digit; the servo winds up `slack` [m] before it pulls."""
        return cls(
            JOINT_INDEX[digit.joints[0]],
            digit.alpha,
            digit.d1**2 + digit.d2**2,
            2 * digit.d1 * digit.d2,
            digit.servo_radius,
            digit.rest_chord + slack,
            digit.drive_stiffness,
            digit.tension_limit,
        )

    def chord_and_arm(self, joint_pos: float) -> tuple[float, float]:
        """Distance of the guides and moment arm ``d₁ d₂ sin(α − q) / chord`` at a root angle [rad], both [m]. Eq. (3)."""
        included = self.alpha - joint_pos
        chord = sqrt(self.squares - self.product * cos(included))
        return chord, 0.5 * self.product * sin(included) / chord

    def tension(self, joint_pos: float, joint_vel: float, servo: float, servo_vel: float) -> tuple[float, float]:
        """Tension [N] and moment arm [m], from angles [rad] and speeds [rad/s] of the root joint and the horn.

        A braking drive's tension is negative.
        """
        chord, arm = self.chord_and_arm(joint_pos)
        stretch = self.servo_radius * servo + chord - self.length
        rate = self.servo_radius * servo_vel - arm * joint_vel
        if stretch > 0.0:
            return min(max(self.stiffness * stretch + self.viscosity * rate, 0.0), self.limit), arm
        return (self.brake * min(rate, 0.0) if joint_vel > 0.0 else 0.0), arm
