"""Hands in metal: a quasi-static simulation of built hands, which shares no code with the model and
its fit.

Each joint is in equilibrium or held by friction, depending on its history: friction is followed
step by step along the servo's path, instead of being assumed to oppose the motion fully. A hand in
metal also has effects that the model omits: compliant servos, guides with a radius, a return cable
that loses tension at every joint, stops. It has no dynamics and no camera.

`hpac_gym.model.settled` solves the same equilibrium in closed form for the effects that the model
contains; `tests/experiments/test_quasistatic.py` compares the two."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpac_gym.errors import HpacError
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Array, Digit, Hand

_ROUNDS = 3000
"""Maximal number of rounds per servo angle: a digit that falls back into a slack tendon needs up to
800, others 80.
"""
_STILL = 2e-7
"""Convergence threshold of the joints' motion in a round [rad]: about 1e-6 rad from equilibrium,
1e-4°.
"""
_STEPS = 3
"""Newton steps of the root joint in each round."""


class SettleError(HpacError, RuntimeError):
    """The equilibrium of a digit does not converge; the message gives the motion in the last
    round.
    """


@dataclass(frozen=True, slots=True)
class Metal:
    """Properties of one built digit beyond the model's parameters."""

    first_segment: float = 2.0
    """Stiffness of a finger's first coupling segment relative to EA/L: 2 as this project assumes
    for Eq. (12), or 1.
    """
    servo_stiffness: float = np.inf
    """Stiffness of the servo at its horn [N·m/rad]."""
    servo_zero: float = 0.0
    """Angle of the horn at the command 0 [rad]."""
    dead_band: float = 0.0
    """Dead band of the servo, in which it does not correct errors [rad]."""
    joint_friction: float = 0.0
    """Friction torque of every joint's bearing [N·m]."""
    tendon_friction: float = 0.0
    """Friction at each joint's guides as a share of the tendons' load."""
    cable_friction: float = 0.0
    """Friction coefficient μ of the return cable round the joints: its tension changes by e^(μ Σq)
    up to a joint.
    """
    guide_radius: float = 0.0
    """Radius of the two pins over which the driving tendon runs [m]."""
    stop: tuple[float, ...] = ()
    """Stop angles of the joints, root first [rad]; no stops if empty."""


@dataclass(frozen=True, slots=True)
class Built:
    """One hand in metal."""

    hand: Hand
    metal: tuple[Metal, ...]
    """One entry for each digit."""


def softened(digit: Digit, metal: Metal) -> float:
    """Stiffness of a digit's driving tendon in series with its servo [N/m]."""
    return 1 / (1 / digit.drive_stiffness + digit.servo_radius**2 / metal.servo_stiffness)


class _Digits:
    """Parameters of many digits with the same number of joints, each of shape (n,) or (n,
    joints).
    """

    def __init__(self, digits: Sequence[Digit], metal: Sequence[Metal]) -> None:
        def column(items: Sequence[Digit | Metal], name: str) -> Array:
            return np.array([getattr(item, name) for item in items], dtype=float)

        self.joint_friction, self.tendon_friction, self.cable_friction, self.guide_radius = (
            column(metal, name)
            for name in ("joint_friction", "tendon_friction", "cable_friction", "guide_radius")
        )
        self.radius, self.spring, self.alpha, self.hub, self.limit = (
            column(digits, name)
            for name in (
                "joint_radius",
                "spring_stiffness",
                "alpha",
                "servo_radius",
                "tension_limit",
            )
        )
        self.stop = np.array([item.stop or [np.inf] * self.radius.shape[1] for item in metal])
        self.segment = column(digits, "tendon_stiffness")[:, None] / column(digits, "path_length")
        if self.segment.shape[1] > 1:
            self.segment[:, 0] *= column(metal, "first_segment")
        self.drive = np.array([softened(*pair) for pair in zip(digits, metal, strict=True)])
        d1 = column(digits, "d1")
        d2 = column(digits, "d2")
        self.guide_sum = d1**2 + d2**2
        self.guide_product = 2 * d1 * d2
        self.rest_path = np.sqrt(self.guide_sum - self.guide_product * np.cos(self.alpha))

    def driven(self, root: Array, horn: Array) -> tuple[Array, Array, Array]:
        """Stretch [m], moment arm [m] and tension [N] of the driving tendons for root and horn
        angles [rad], all of shape (n,).

        The tendon passes both pins on the side of the joint. Its wrap angle is the joint angle, and
        its line is closer to the joint's axis by the pins' radius."""
        included = self.alpha - root
        chord = np.sqrt(self.guide_sum - self.guide_product * np.cos(included))
        arm = 0.5 * self.guide_product * np.sin(included) / chord
        stretch = self.hub * horn - (self.rest_path - (chord + self.guide_radius * root))
        tension = np.minimum(np.maximum(self.drive * stretch, 0.0), self.limit)
        return stretch, np.maximum(arm - self.guide_radius, 1e-6), tension


def follow(digits: Sequence[Digit], metal: Sequence[Metal], servo: Array, groups: int = 1) -> Array:
    """Joint angles of many digits along a slow path of their servos that starts with straight
    digits.

    Args:
        digits: digits with the same number of joints.
        metal: properties of each digit.
        servo: commanded angles, one path per digit, shape (steps, n) [rad]; a step should move the
            digit by a few degrees at most, so that friction acts along the path.
        groups: number of equally sized groups of digits; each iterates until it converges, so its
            result is bit-identical to a separate call.

    Returns:
        Shape (steps, n, joints), root first [rad].

    Raises:
        SettleError: A digit does not come to rest.
    """
    numbers = _Digits(digits, metal)
    zero, dead_band = (
        np.array([getattr(item, name) for item in metal]) for name in ("servo_zero", "dead_band")
    )
    joint_pos = np.zeros_like(numbers.radius)
    horn = np.zeros(len(digits))
    course = np.empty((len(servo), *joint_pos.shape))
    for step, commanded in enumerate(servo):
        horn = np.clip(horn, commanded - dead_band, commanded + dead_band)
        joint_pos = _rest(joint_pos, numbers, horn + zero, groups)
        course[step] = joint_pos
    return course


def _rest(before: Array, numbers: _Digits, horn: Array, groups: int) -> Array:
    """Equilibrium angles reached from angles `before`, shape (n, joints), iterating over the joints
    until all groups converge.
    """
    joint_pos = before.copy()
    rests = np.zeros(groups, dtype=bool)
    for _ in range(_ROUNDS):
        last = joint_pos.copy()
        for joint in range(joint_pos.shape[1]):
            friction = _friction(joint, joint_pos, numbers, horn)
            flexed, extended = _balance(
                joint, joint_pos, numbers, horn, np.stack([friction, -friction])
            )
            # friction holds the joint between the two angles; it moves only if it is outside
            held = np.minimum(np.maximum(before[:, joint], flexed), extended)
            joint_pos[:, joint] = np.minimum(np.maximum(held, 0.0), numbers.stop[:, joint])
        joint_pos.reshape(groups, -1)[rests] = last.reshape(groups, -1)[rests]
        moved = np.abs(joint_pos - last).reshape(groups, -1).max(axis=1)
        rests |= moved < _STILL
        if rests.all():
            return joint_pos
    raise SettleError(
        f"joints still move by {moved.max():.1e} rad in round {_ROUNDS}, the last; at rest is below {_STILL} rad"
    )


def _friction(joint: int, joint_pos: Array, numbers: _Digits, horn: Array) -> Array:
    """Largest friction torque on a joint, shape (n,) [N·m]."""
    radius = numbers.radius
    coupling = np.abs(
        numbers.segment * (radius[:, :-1] * joint_pos[:, :-1] - radius[:, 1:] * joint_pos[:, 1:])
    )
    spring = numbers.spring * (radius * joint_pos).sum(axis=1)
    load = radius[:, joint] * (coupling[:, max(joint - 1, 0) : joint + 1].sum(axis=1) + spring)
    if joint == 0:
        _, arm, tension = numbers.driven(joint_pos[:, 0], horn)
        load = load + arm * tension
    slide = np.expm1(numbers.cable_friction * joint_pos[:, : joint + 1].sum(axis=1))
    return (
        numbers.joint_friction + numbers.tendon_friction * load + radius[:, joint] * spring * slide
    )


def _balance(joint: int, joint_pos: Array, numbers: _Digits, horn: Array, against: Array) -> Array:
    """Angle of one joint, with the others fixed, at which the flexion torque equals `against`,
    shape (..., n) [rad, N·m].
    """
    radius = numbers.radius
    own = radius[:, joint]
    stiffness = numbers.spring.copy()
    pull = numbers.spring * ((radius * joint_pos).sum(axis=1) - own * joint_pos[:, joint])
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
        # limit the step to where a slack tendon gets taut, or a servo at its torque limit holds
        # again
        slack = stretch / arm - 1e-7
        spare = (stretch - numbers.limit / numbers.drive) / arm
        step = np.maximum(
            step, np.where(stretch > 0, np.where((spare > 0) & (torque > 0), spare, -np.inf), slack)
        )
        angle = np.minimum(angle + step, numbers.alpha - 1e-3)
    return angle


def hand_course(
    built: Sequence[Built], servo: Array, steps: int = 1, servos: Sequence[int] = range(len(SERVOS))
) -> Array:
    """Joint angles of hands in metal along slow paths of their servos from the open hand.

    Args:
        built: the hands.
        servo: commanded angles, shape (k, 6), or (hands, k, 6) for one path per hand [rad].
        steps: quasi-static steps per row of `servo`.
        servos: indices of the moving servos; the joints of the others stay at 0.

    Returns:
        Joint angles, shape (hands, k, 15) [rad].

    Raises:
        SettleError: The equilibrium of a digit does not converge.
    """
    servo = np.broadcast_to(servo, (len(built), *servo.shape[-2:]))
    rows = np.arange(servo.shape[1])
    fine = np.arange(0, rows[-1] + 0.5 / steps, 1 / steps)
    course = np.zeros((*servo.shape[:2], len(JOINTS)))
    moving = [
        (column, name) for column, name in enumerate(built[0].hand.digits) if column in servos
    ]
    for joints in {len(HPAC.digits[name].joints) for _, name in moving}:
        alike = [
            (column, name) for column, name in moving if len(HPAC.digits[name].joints) == joints
        ]
        digits = [item.hand.digits[name] for _, name in alike for item in built]
        metal = [item.metal[column] for column, _ in alike for item in built]
        path = np.stack(
            [
                np.interp(fine, rows, angles)
                for column, _ in alike
                for angles in servo[:, :, column]
            ],
            axis=1,
        )
        courses = follow(digits, metal, path, len(alike))[::steps]
        for (_, name), course_of in zip(alike, np.split(courses, len(alike), axis=1), strict=True):
            course[:, :, [JOINT_INDEX[joint] for joint in HPAC.digits[name].joints]] = (
                course_of.transpose(1, 0, 2)
            )
    if len(SERVOS) - 1 in servos:
        course[:, :, JOINT_INDEX["thumb_cmc"]] = (
            np.array([[item.hand.cmc_gain] for item in built]) * servo[:, :, -1]
        )
    return course
