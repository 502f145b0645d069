"""The hand at rest on its servos, in closed form: the physics of `hpac_gym.sim.tendons` without time.

What Eqs. (12), (13) leave out is here: the driving tendon's stretch and friction. All of a digit's angles and tensions are then
linear in the root joint's angle, and the servo angle is an explicit function of it. Free space, no gravity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array, as_finite_array

FLEXION, EXTENSION = 1.0, -1.0
_TINY = 1e-9  # where a folded digit has no arm left
_ITERATIONS = 8  # of a contraction by less than 0.05 each


@dataclass(frozen=True, slots=True)
class Friction:
    """Dry friction of the joints, against the motion.

    A joint's friction torque is `joint` + `tendon` times the torque of the tendons that load it.
    """

    joint: float = 0.0
    """Of every joint's bearing [N·m]."""
    tendon: float = 0.0
    """Share of the tendons' load that each joint's guides hold back."""


@dataclass(frozen=True, slots=True)
class DigitStatics:
    """A digit in equilibrium: what is linear in the root joint's angle q, as slope and offset.

    Joints and the first tension run root first; angles q_i = slope_i q + offset_i.
    """

    slope: Array
    """Shape (n,) [rad/rad]."""
    offset: Array
    """Shape (n,) [rad]."""
    load_slope: float
    """Torque on the root joint per radian, which the driving tendon has to balance [N·m/rad]."""
    load_offset: float
    """[N·m]."""


def digit_statics(digit: Digit, friction: Friction = Friction(), direction: float = FLEXION) -> DigitStatics:
    """Balance of torques of every joint but the root, and stretch of every coupling segment.

    Unknowns are the other joints' angles, the segments' tensions and the spring's, all linear in the root joint's angle. Every
    coupling segment is taut. Its stiffness is EA/L, and 2EA/L for a finger's first: see `hpac_gym.sim.tendons`.

    Args:
        digit: the tendon's numbers.
        friction: what holds the joints back.
        direction: `FLEXION` or `EXTENSION`, the motion that friction opposes.
    """
    radius, count = np.array(digit.joint_radius), len(digit.joints)
    segments = count - 1
    doubled = np.where((np.arange(segments) == 0) & (segments > 1), 2.0, 1.0)
    stiffness = doubled * digit.tendon_stiffness / np.array(digit.path_length)
    pull, lag = 1 - direction * friction.tendon, 1 + direction * friction.tendon

    # x = [q_1 … q_(n−1), c_0 … c_(n−2), T]; matrix x = of_root q_0 + constant
    size = 2 * segments + 1
    matrix, of_root, constant = np.zeros((size, size)), np.zeros(size), np.zeros(size)
    tension, spring = segments + np.arange(segments), size - 1
    for joint in range(1, count):
        row = joint - 1  # R (c_before pull − (c_after + T) lag) = direction · friction
        matrix[row, tension[joint - 1]] = radius[joint] * pull
        if joint < segments:
            matrix[row, tension[joint]] = -radius[joint] * lag
        matrix[row, spring] = -radius[joint] * lag
        constant[row] = direction * friction.joint
        row = segments + joint - 1  # c / K + R q − R_before q_before = 0
        matrix[row, tension[joint - 1]] = 1 / stiffness[joint - 1]
        matrix[row, joint - 1] = radius[joint]
        if joint == 1:
            of_root[row] = radius[0]
        else:
            matrix[row, joint - 2] = -radius[joint - 1]
    matrix[spring, spring] = 1 / digit.spring_stiffness  # T / k_s − Σ R q = R_0 q_0
    matrix[spring, :segments] = -radius[1:]
    of_root[spring] = radius[0]
    slope, offset = np.linalg.solve(matrix, np.stack([of_root, constant], axis=1)).T

    share = lag / pull
    return DigitStatics(
        slope=np.concatenate([[1.0], slope[:segments]]),
        offset=np.concatenate([[0.0], offset[:segments]]),
        load_slope=float(radius[0] * share * (slope[tension[0]] + slope[spring])),
        load_offset=float(radius[0] * share * (offset[tension[0]] + offset[spring]) + direction * friction.joint / pull),
    )


def settled_joints(
    servo: ArrayLike, hand: Hand = HPAC, friction: Friction = Friction(), direction: float = FLEXION
) -> Array:
    """Joint angles at which the hand comes to rest after a slow motion in one direction.

    Args:
        servo: u, shape (..., 6) [rad].
        hand: the parameters, `drive_stiffness` among them.
        friction: what holds the joints back.
        direction: `FLEXION` or `EXTENSION`.

    Returns:
        q, shape (..., 15) [rad]; a joint that friction keeps at its stop stays at 0.

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    servo = as_finite_array(servo, len(SERVOS), "servo")
    joint_pos = np.empty((*servo.shape[:-1], len(JOINTS)))
    for column, digit in enumerate(hand.digits.values()):
        joint_pos[..., [JOINT_INDEX[name] for name in digit.joints]] = settled_digit(
            servo[..., column], digit, friction, direction
        )
    joint_pos[..., JOINT_INDEX["thumb_cmc"]] = np.maximum(
        hand.cmc_gain * servo[..., -1] - direction * friction.joint / hand.cmc_stiffness, 0.0
    )
    return joint_pos


def settled_digit(servo: Array, digit: Digit, friction: Friction = Friction(), direction: float = FLEXION) -> Array:
    """`settled_joints` of one digit: servo angles (...) to joint angles (..., n), root first."""
    statics = digit_statics(digit, friction, direction)
    product, squares = 2 * digit.d1 * digit.d2, digit.d1**2 + digit.d2**2
    rest_chord = digit.rest_chord
    slack_below = max(-statics.load_offset / statics.load_slope, 0.0)  # friction alone holds the spring there
    stretch, root = np.zeros_like(servo), np.zeros_like(servo)
    for _ in range(_ITERATIONS):
        chord = rest_chord - np.maximum(digit.servo_radius * servo - stretch, 0.0)
        root = digit.alpha - np.arccos(np.clip((squares - chord**2) / product, -1.0, 1.0))
        arm = np.maximum(product / 2 * np.sin(digit.alpha - root), _TINY) / np.maximum(chord, _TINY)
        tension = np.maximum(statics.load_slope * root + statics.load_offset, 0.0) / arm
        stretch = np.minimum(tension, digit.tension_limit) / digit.drive_stiffness
    root = np.maximum(root, slack_below)
    return np.maximum(statics.slope * root[..., None] + statics.offset, 0.0)
