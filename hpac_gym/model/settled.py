"""Static equilibrium of the hand in closed form, with effects that Eqs. (12), (13) omit, and the
command that compensates them.

These effects are the driving tendon's stretch, friction and servo zeros. All angles and tensions of
a digit are linear in the root joint's angle, so the servo angle is an explicit function of it. Free
space, no gravity, slow motion in one direction."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model.calibration import Friction
from hpac_gym.model.checks import Array, as_bounded_array, as_finite_array
from hpac_gym.model.files import HPAC
from hpac_gym.model.guides import included_from_chord
from hpac_gym.model.joints import JOINT_INDEX, JOINTS, SERVOS
from hpac_gym.model.parameters import Digit, Hand

FLEXION = 1.0
EXTENSION = -1.0
NO_FRICTION = Friction()
_TINY = 1e-9  # avoids division by zero where a folded digit has no moment arm
_ITERATIONS = 6
"""Fixed-point iterations, each a contraction by less than 0.05 for drives of at least 2.5e4 N/m."""
_CMC = len(SERVOS) - 1


@dataclass(frozen=True, slots=True)
class DigitStatics:
    """Equilibrium of a digit as linear functions of the root joint's angle q, given by slope and
    offset.

    Joints run root first, with angles q_i = slope_i q + offset_i.
    """

    slope: Array
    """Shape (n,) [rad/rad]."""
    offset: Array
    """Shape (n,) [rad]."""
    load_slope: float
    """Torque on the root joint per radian, which the driving tendon has to balance [N·m/rad]."""
    load_offset: float
    """Offset of that torque [N·m]."""


def digit_statics(
    digit: Digit, friction: Friction = NO_FRICTION, direction: float = FLEXION
) -> DigitStatics:
    """Solve the torque balance of every joint but the root, with the stretch of every coupling
    segment.

    Unknowns are the other joints' angles, the segments' tensions and the spring's, all linear in
    the root joint's angle. Every coupling segment is taut, with `Digit.segment_stiffness`.

    Args:
        digit: the tendon's parameters.
        friction: dry friction of the joints.
        direction: `FLEXION` or `EXTENSION`, the motion that friction opposes.
    """
    root = digit.joint_radius[0]
    radius = np.array(digit.joint_radius[1:])
    count = len(radius)
    pull = 1 - direction * friction.tendon
    lag = 1 + direction * friction.tendon

    # matrix @ [q_1 … q_(n−1), c_0 … c_(n−2), T] = of_root q_0 + constant
    matrix = np.zeros((2 * count + 1, 2 * count + 1))
    # R (c_before pull − (c_after + T) lag) = direction · friction, for every joint but the root
    matrix[:count, count:-1] = pull * np.diag(radius) - lag * np.diag(radius[:-1], 1)
    matrix[:count, -1] = -lag * radius
    # c / K + R q − R_before q_before = 0, for every segment
    matrix[count:-1, :count] = np.diag(radius) - np.diag(radius[:-1], -1)
    matrix[count:-1, count:-1] = np.diag(1 / digit.segment_stiffness)
    # T / k_s − Σ R q = R_0 q_0
    matrix[-1, :count] = -radius
    matrix[-1, -1] = 1 / digit.spring_stiffness
    of_root = np.zeros(len(matrix))
    of_root[[count, -1]] = root
    constant = np.zeros(len(matrix))
    constant[:count] = direction * friction.joint
    slope, offset = np.linalg.solve(matrix, np.stack([of_root, constant], axis=1)).T

    share = lag / pull
    return DigitStatics(
        slope=np.concatenate([[1.0], slope[:count]]),
        offset=np.concatenate([[0.0], offset[:count]]),
        load_slope=float(root * share * (slope[count] + slope[-1])),
        load_offset=float(
            root * share * (offset[count] + offset[-1]) + direction * friction.joint / pull
        ),
    )


def settled_joints_from_servo(
    servo: ArrayLike, hand: Hand = HPAC, direction: float = FLEXION
) -> Array:
    """Joint angles at which the hand comes to rest after a slow motion in one direction.

    Args:
        servo: commanded u, shape (..., 6) [rad].
        hand: the parameters, `drive_stiffness` and `calibration` among them.
        direction: `FLEXION` or `EXTENSION`.

    Returns:
        q, shape (..., 15) [rad]; a joint that friction holds at its stop is at 0.

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    servo = as_finite_array(servo, len(SERVOS), "servo") + hand.calibration.servo_zero
    joint_pos = np.empty((*servo.shape[:-1], len(JOINTS)))
    for column, digit in enumerate(hand.digits.values()):
        settled = settled_digit(
            servo[..., column], digit, hand.calibration.friction[column], direction
        )
        joint_pos[..., [JOINT_INDEX[name] for name in digit.joints]] = settled
    joint_pos[..., JOINT_INDEX["thumb_cmc"]] = np.maximum(hand.cmc_gain * servo[..., _CMC], 0.0)
    return joint_pos


def settled_digit(
    horn: Array, digit: Digit, friction: Friction = NO_FRICTION, direction: float = FLEXION
) -> Array:
    """`settled_joints_from_servo` for one digit: true horn angles (...) to joint angles (..., n),
    root first [rad].
    """
    statics = digit_statics(digit, friction, direction)
    guide_sum = digit.d1**2 + digit.d2**2
    guide_product = 2 * digit.d1 * digit.d2
    rest_chord = digit.rest_chord
    # Below this angle friction alone holds the spring.
    slack_below = max(-statics.load_offset / statics.load_slope, 0.0)
    stretch = np.zeros_like(horn)
    for _ in range(_ITERATIONS):
        chord = rest_chord - np.maximum(digit.servo_radius * horn - stretch, 0.0)
        root = digit.alpha - included_from_chord(guide_sum, guide_product, chord)
        stretch = _drive_stretch(root, digit, statics)
    root = np.maximum(root, slack_below)
    return np.maximum(statics.slope * root[..., None] + statics.offset, 0.0)


def _drive_stretch(root: Array, digit: Digit, statics: DigitStatics) -> Array:
    """Stretch of the driving tendon [m] that holds the digit with its root joint at an angle
    [rad].
    """
    arm = digit.d1 * digit.d2 * np.sin(digit.alpha - root)
    arm = np.maximum(arm, _TINY) / np.maximum(digit.chord(root), _TINY)
    tension = np.maximum(statics.load_slope * root + statics.load_offset, 0.0) / arm
    return np.minimum(tension, digit.tension_limit) / digit.drive_stiffness


def settled_servo_from_joints(
    joint_pos: ArrayLike, hand: Hand = HPAC, direction: float = FLEXION
) -> Array:
    """Servo angles whose equilibrium is nearest to a posture, by least squares per digit: Eq. (15)
    with the identified parameters of this hand.

    `servo_from_joints` takes the driving tendon as rigid, the servos' zeros as exact and the joints
    as free of friction. This one adds the tendon's stretch, subtracts the zeros and allows for the
    friction of the direction in which the hand moves.

    Args:
        joint_pos: q̃, inside of Table I (see `clip_to_workspace`), shape (..., 15) [rad].
        hand: the identified hand.
        direction: `FLEXION` or `EXTENSION`, in which the hand approaches the posture.

    Returns:
        u, not clipped to the servos' range, shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape.
        WorkspaceError: NaN, or a joint outside of Table I.
    """
    joint_pos = as_bounded_array(
        joint_pos, hand.joint_min, hand.joint_max, JOINTS, "joint_pos", "rad"
    )
    synergy = np.empty((*joint_pos.shape[:-1], len(SERVOS)))
    for column, digit in enumerate(hand.digits.values()):
        statics = digit_statics(digit, hand.calibration.friction[column], direction)
        wanted = joint_pos[..., [JOINT_INDEX[name] for name in digit.joints]] - statics.offset
        synergy[..., column] = wanted @ statics.slope / (statics.slope @ statics.slope)
    synergy[..., _CMC] = joint_pos[..., JOINT_INDEX["thumb_cmc"]]
    synergy = np.clip(synergy, hand.synergy_min, hand.synergy_max)
    return settled_servo_from_synergy(synergy, hand, direction)


def settled_servo_from_synergy(
    synergy: Array, hand: Hand = HPAC, direction: float = FLEXION
) -> Array:
    """Servo angles at which the driven joints come to rest at given angles.

    Args:
        synergy: finite angles of the driven joints, shape (..., 6) [rad].
        hand: the identified hand.
        direction: `FLEXION` or `EXTENSION`, in which the hand approaches them.

    Returns:
        u, not clipped to the servos' range, shape (..., 6) [rad].
    """
    servo = np.empty_like(synergy)
    for column, digit in enumerate(hand.digits.values()):
        statics = digit_statics(digit, hand.calibration.friction[column], direction)
        root = synergy[..., column]
        stretch = np.where(root > 0, _drive_stretch(root, digit, statics), 0.0)
        wound = digit.rest_chord - digit.chord(root) + stretch
        servo[..., column] = wound / digit.servo_radius
    servo[..., _CMC] = synergy[..., _CMC] / hand.cmc_gain
    return servo - hand.calibration.servo_zero
