"""Hands in metal, at rest at every servo angle: a second physics, which shares no code with the model and its fit.

Each joint is in balance or held by friction, and remembers where it was: the friction of a slow motion is followed step by step
along the servo's path, not assumed to be fully against it. A hand in metal also has what the model leaves out: servos that give
way, guides with a radius, a return cable that loses tension at every joint, stops. It has no dynamics and no camera.

`hpac_gym.model.settled` solves the same balance in closed form for the parts that the model knows;
`tests/study/test_quasistatic.py` compares the two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpac_gym.errors import HpacError
from hpac_gym.model import JOINT_INDEX, JOINTS, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array

_ROUNDS = 3000
"""Most rounds over the joints for one servo angle: a digit falls back into a slack tendon in up to 800, all others need 80."""
_STILL = 2e-7
"""A round that moves no joint further than this is the last [rad]: some 1e-6 rad from the balance, 1e-4°."""
_STEPS = 3
"""Newton's steps of the root joint in each round."""


class SettleError(HpacError, RuntimeError):
    """A digit in metal does not come to rest: the message gives what its joints still move in the last round."""


@dataclass(frozen=True, slots=True)
class Metal:
    """Build of one digit, beyond the numbers of the model."""

    first_segment: float = 2.0
    """Stiffness of a finger's first coupling segment over EA/L: 2 is this project's reading of Eq. (12), 1 the plain one."""
    servo_stiffness: float = np.inf
    """Stiffness of the servo at its horn [N·m/rad]."""
    servo_zero: float = 0.0
    """Where the horn stands when the servo is commanded to 0 [rad]."""
    dead_band: float = 0.0
    """Error that the servo leaves alone [rad]."""
    joint_friction: float = 0.0
    """Friction torque of every joint's bearing [N·m]."""
    tendon_friction: float = 0.0
    """Share of the tendons' load that each joint's guides hold back."""
    cable_friction: float = 0.0
    """Coefficient μ with which the return cable slides round the joints: its tension changes by e^(μ Σq) up to a joint."""
    guide_radius: float = 0.0
    """Radius of the two pins over which the driving tendon runs [m]."""
    stop: tuple[float, ...] = ()
    """Angles at which the joints meet their stops, root first [rad]; none if empty."""


@dataclass(frozen=True, slots=True)
class Built:
    """One hand in metal."""

    hand: Hand
    metal: tuple[Metal, ...]
    """One entry for each digit."""


class _Digits:
    """Numbers of many digits with the same number of joints, each of shape (n,) or (n, joints)."""

    def __init__(self, digits: Sequence[Digit], metal: Sequence[Metal]) -> None:
        def column(items: Sequence[Digit | Metal], name: str) -> Array:
            return np.array([getattr(item, name) for item in items], dtype=float)

        self.joint_friction, self.tendon_friction, self.cable_friction, self.guide_radius = (
            column(metal, name) for name in ("joint_friction", "tendon_friction", "cable_friction", "guide_radius")
        )
        self.radius, self.spring, self.alpha, self.hub, self.limit = (
            column(digits, name) for name in ("joint_radius", "spring_stiffness", "alpha", "servo_radius", "tension_limit")
        )
        self.stop = np.array([item.stop or [np.inf] * self.radius.shape[1] for item in metal])
        self.segment = column(digits, "tendon_stiffness")[:, None] / column(digits, "path_length")
        if self.segment.shape[1] > 1:
            self.segment[:, 0] *= column(metal, "first_segment")
        self.drive = 1 / (1 / column(digits, "drive_stiffness") + self.hub**2 / column(metal, "servo_stiffness"))
        d1, d2 = column(digits, "d1"), column(digits, "d2")
        self.guide_sum, self.guide_product = d1**2 + d2**2, 2 * d1 * d2
        self.rest_path = np.sqrt(self.guide_sum - self.guide_product * np.cos(self.alpha))

    def driven(self, root: Array, horn: Array) -> tuple[Array, Array, Array]:
        """Stretch [m], moment arm [m] and tension [N] of the driving tendons, (n,), for angles of roots and horns, (n,) [rad].

        The tendon runs on the joint's side of both pins. It wraps round them by as much as the joint turns, and its line lies
        closer to the joint's axis by the pins' radius.
        """
        included = self.alpha - root
        chord = np.sqrt(self.guide_sum - self.guide_product * np.cos(included))
        arm = 0.5 * self.guide_product * np.sin(included) / chord
        stretch = self.hub * horn - (self.rest_path - (chord + self.guide_radius * root))
        tension = np.minimum(np.maximum(self.drive * stretch, 0.0), self.limit)
        return stretch, np.maximum(arm - self.guide_radius, 1e-6), tension


def follow(digits: Sequence[Digit], metal: Sequence[Metal], servo: Array) -> Array:
    """Joint angles of many digits along a slow path of their servos, which starts with every digit straight.

    Args:
        digits: all with the same number of joints.
        metal: one for each digit.
        servo: commanded angles, one path for each digit, shape (steps, n) [rad]; a step should move the digit by no more than
            some degrees, so that friction acts along the way.

    Returns:
        Shape (steps, n, joints), root first [rad].

    Raises:
        SettleError: A digit does not come to rest.
    """
    numbers = _Digits(digits, metal)
    zero, dead_band = (np.array([getattr(item, name) for item in metal]) for name in ("servo_zero", "dead_band"))
    joint_pos, horn = np.zeros_like(numbers.radius), np.zeros(len(digits))
    course = np.empty((len(servo), *joint_pos.shape))
    for step, commanded in enumerate(servo):
        horn = np.clip(horn, commanded - dead_band, commanded + dead_band)
        joint_pos = _rest(joint_pos, numbers, horn + zero)
        course[step] = joint_pos
    return course


def _rest(before: Array, numbers: _Digits, horn: Array) -> Array:
    """Angles at which digits come to rest from angles `before`, shape (n, joints): joint by joint until none moves any more."""
    joint_pos = before.copy()
    for _ in range(_ROUNDS):
        last = joint_pos.copy()
        for joint in range(joint_pos.shape[1]):
            friction = _friction(joint, joint_pos, numbers, horn)
            flexed, extended = _balance(joint, joint_pos, numbers, horn, np.stack([friction, -friction]))
            # held by friction between the two; it leaves its place only if that lies outside of them
            held = np.minimum(np.maximum(before[:, joint], flexed), extended)
            joint_pos[:, joint] = np.minimum(np.maximum(held, 0.0), numbers.stop[:, joint])
        moved = np.abs(joint_pos - last).max()
        if moved < _STILL:
            return joint_pos
    raise SettleError(f"joints still move by {moved:.1e} rad in round {_ROUNDS}, the last; at rest is below {_STILL} rad")


def _friction(joint: int, joint_pos: Array, numbers: _Digits, horn: Array) -> Array:
    """Largest friction torque on a joint, shape (n,) [N·m]."""
    radius = numbers.radius
    coupling = np.abs(numbers.segment * (radius[:, :-1] * joint_pos[:, :-1] - radius[:, 1:] * joint_pos[:, 1:]))
    spring = numbers.spring * (radius * joint_pos).sum(axis=1)
    load = radius[:, joint] * (coupling[:, max(joint - 1, 0) : joint + 1].sum(axis=1) + spring)
    if joint == 0:
        _, arm, tension = numbers.driven(joint_pos[:, 0], horn)
        load = load + arm * tension
    slide = np.expm1(numbers.cable_friction * joint_pos[:, : joint + 1].sum(axis=1))
    return numbers.joint_friction + numbers.tendon_friction * load + radius[:, joint] * spring * slide


def _balance(joint: int, joint_pos: Array, numbers: _Digits, horn: Array, against: Array) -> Array:
    """Angle of one joint, the others held, at which the torque in flexion equals `against`, both of shape (..., n) [rad, N·m]."""
    radius = numbers.radius
    own = radius[:, joint]
    stiffness, pull = numbers.spring.copy(), numbers.spring * ((radius * joint_pos).sum(axis=1) - own * joint_pos[:, joint])
    pull = -pull  # net tension on the joint at zero angle, and how fast it falls with own * q
    if joint > 0:
        stiffness = stiffness + numbers.segment[:, joint - 1]
        pull = pull + numbers.segment[:, joint - 1] * radius[:, joint - 1] * joint_pos[:, joint - 1]
    if joint < radius.shape[1] - 1:
        stiffness = stiffness + numbers.segment[:, joint]
        pull = pull + numbers.segment[:, joint] * radius[:, joint + 1] * joint_pos[:, joint + 1]
    if joint > 0:
        return (pull - against / own) / (stiffness * own)
    angle = np.broadcast_to(joint_pos[:, 0], against.shape)
    for _ in range(_STEPS):
        stretch, arm, tension = numbers.driven(angle, horn)
        torque = arm * tension + own * (pull - stiffness * own * angle) - against
        step = torque / (np.where(stretch > 0, numbers.drive * arm**2, 0.0) + stiffness * own**2)
        # a slack digit falls no further than into its tendon, and a servo at its limit yields until it holds
        slack, spare = stretch / arm - 1e-7, (stretch - numbers.limit / numbers.drive) / arm
        step = np.maximum(step, np.where(stretch > 0, np.where((spare > 0) & (torque > 0), spare, -np.inf), slack))
        angle = np.minimum(angle + step, numbers.alpha - 1e-3)
    return angle


def hand_course(built: Sequence[Built], servo: Array, steps: int = 1, servos: Sequence[int] = range(len(SERVOS))) -> Array:
    """Joint angles of hands in metal along slow paths of their servos from the open hand.

    Args:
        built: the hands.
        servo: commanded angles, shape (k, 6), or (hands, k, 6) where every hand has a path of its own [rad].
        steps: from one row of `servo` to the next.
        servos: indices of those that move; the joints of the others are left at 0.

    Returns:
        Shape (hands, k, 15) [rad].

    Raises:
        SettleError: A digit does not come to rest.
    """
    servo = np.broadcast_to(servo, (len(built), *servo.shape[-2:]))
    rows = np.arange(servo.shape[1])
    fine = np.arange(0, rows[-1] + 0.5 / steps, 1 / steps)
    course = np.zeros((*servo.shape[:2], len(JOINTS)))
    for column, name in enumerate(built[0].hand.digits):
        if column in servos:
            digits = [item.hand.digits[name] for item in built]
            path = np.stack([np.interp(fine, rows, angles) for angles in servo[:, :, column]], axis=1)
            found = follow(digits, [item.metal[column] for item in built], path)[::steps]
            course[:, :, [JOINT_INDEX[joint] for joint in digits[0].joints]] = found.transpose(1, 0, 2)
    if len(SERVOS) - 1 in servos:
        course[:, :, JOINT_INDEX["thumb_cmc"]] = np.array([[item.hand.cmc_gain] for item in built]) * servo[:, :, -1]
    return course
