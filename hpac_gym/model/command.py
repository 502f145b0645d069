"""Eqs. (14), (15) and the pipeline around them: from an action or a posture to the servo command."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.errors import WorkspaceError
from hpac_gym.model.checks import (
    Array,
    as_array,
    as_bounded_array,
    as_finite_array,
    as_finite_vector,
    read_only,
)
from hpac_gym.model.files import HPAC
from hpac_gym.model.joints import JOINTS, SERVOS
from hpac_gym.model.parameters import Hand, unchecked_servo_from_synergy
from hpac_gym.model.transmission import row_by_row

_ACTION_BOUND = np.ones(len(SERVOS))
ACTION_TOLERANCE = 1e-6
"""Actions beyond ±1 by at most this are clipped: float32 arithmetic in a rescaling wrapper can
overshoot by a few 1e-7.
"""


@dataclass(frozen=True, slots=True)
class ServoCommand:
    """Target angles of all six servos and the duration of their synchronised move.

    Raises:
        ShapeError: `servo` is not six finite numbers.
        WorkspaceError: `duration` is not finite and positive.
    """

    servo: Array
    """Target angles u, shape (6,) [rad], read-only."""
    duration: float
    """Duration of the move [s]."""

    def __post_init__(self) -> None:
        servo = as_finite_vector(self.servo, len(SERVOS), "servo")
        object.__setattr__(self, "servo", read_only(servo.copy()))
        _require_duration(self.duration)


def _require_duration(duration: float) -> None:
    if not 0 < duration < np.inf:
        raise WorkspaceError(f"duration = {duration} s must be finite and greater than 0 s")


def synergy_from_action(action: ArrayLike, hand: Hand = HPAC) -> Array:
    """Synergy coordinates of an action: −1 is Table I's lower bound (open), 1 its upper bound
    (closed).

    Args:
        action: shape (..., 6), −1…1, in the order of `SERVOS`.

    Returns:
        shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape.
        WorkspaceError: NaN, or outside −1…1 by more than float32 rounding.
    """
    action = as_array(action, len(SERVOS), "action")
    if not np.abs(action).max(initial=0.0) <= 1 + ACTION_TOLERANCE:
        as_bounded_array(
            action, -_ACTION_BOUND, _ACTION_BOUND, SERVOS, "action", "(no unit)", ACTION_TOLERANCE
        )
    share = np.minimum(np.maximum(action + 1, 0.0), 2.0) / 2
    return hand.synergy_min + share * (hand.synergy_max - hand.synergy_min)


def action_from_synergy(synergy: ArrayLike, hand: Hand = HPAC) -> Array:
    """Action for given synergy coordinates: the inverse of `synergy_from_action`.

    Args:
        synergy: shape (..., 6) [rad].

    Returns:
        shape (..., 6), −1…1.

    Raises:
        ShapeError: Wrong shape.
        WorkspaceError: NaN, or outside of Table I.
    """
    synergy = as_bounded_array(
        synergy, hand.synergy_min, hand.synergy_max, SERVOS, "synergy", "rad"
    )
    action = 2 * (synergy - hand.synergy_min) / (hand.synergy_max - hand.synergy_min) - 1
    return np.minimum(np.maximum(action, -1.0), 1.0)


def synergy_from_joints(joint_pos: ArrayLike, hand: Hand = HPAC) -> Array:
    """Manifold coordinates nearest to a posture: least-squares fit of A q_root to q + b(q) for each
    digit.

    Exact on the elastic manifold. Not clipped: off the manifold a coordinate can exceed Table I.

    Args:
        joint_pos: q, shape (..., 15) [rad].

    Returns:
        synergy, shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    joint_pos = as_finite_array(joint_pos, len(JOINTS), "joint_pos")
    return row_by_row(joint_pos, hand.synergy_projection)


def clip_to_workspace(joint_pos: ArrayLike, hand: Hand = HPAC) -> Array:
    """Joint angles, each clipped to its admissible range.

    Eq. (14), with Table I. The box is larger than the set that six servos can reach;
    `servo_from_joints` projects onto that set.

    Args:
        joint_pos: q_d, shape (..., 15) [rad].

    Returns:
        q̃_d, shape (..., 15) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    joint_pos = as_finite_array(joint_pos, len(JOINTS), "joint_pos")
    return np.minimum(np.maximum(joint_pos, hand.joint_min), hand.joint_max)


def clip_synergy(synergy: ArrayLike, hand: Hand = HPAC) -> Array:
    """Synergy coordinates, each clipped to the range of its driven joint in Table I.

    Args:
        synergy: shape (..., 6) [rad].

    Returns:
        shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    synergy = as_finite_array(synergy, len(SERVOS), "synergy")
    return np.minimum(np.maximum(synergy, hand.synergy_min), hand.synergy_max)


def servo_from_joints(joint_pos: ArrayLike, hand: Hand = HPAC) -> Array:
    """Servo angles for a posture: H⁺[q̃ + b(q̃)].

    Eq. (15). H⁺ is the closed-form inverse of each digit's block: exact on the elastic manifold,
    least squares per digit off it. The result is clipped to the servo range, that is to Table I of
    the six driven joints.

    Args:
        joint_pos: q̃, inside of Table I (see `clip_to_workspace`), shape (..., 15) [rad].

    Returns:
        u★, shape (..., 6) [rad], within `hand.servo_min` and `hand.servo_max`.

    Raises:
        ShapeError: Wrong shape.
        WorkspaceError: NaN, or a joint outside of Table I.
    """
    joint_pos = as_bounded_array(
        joint_pos, hand.joint_min, hand.joint_max, JOINTS, "joint_pos", "rad"
    )
    return _servo_from_admissible_joints(joint_pos, hand)


def _servo_from_admissible_joints(joint_pos: Array, hand: Hand) -> Array:
    synergy = row_by_row(joint_pos, hand.synergy_projection)
    np.maximum(synergy, hand.synergy_min, out=synergy)
    np.minimum(synergy, hand.synergy_max, out=synergy)
    return unchecked_servo_from_synergy(synergy, hand)


def servo_from_action(action: ArrayLike, hand: Hand = HPAC) -> Array:
    """Servo angles for an action: the whole pipeline, action → synergy → joints → workspace →
    servos.

    Combines `synergy_from_action`, `joints_from_synergy`, `clip_to_workspace` and
    `servo_from_joints`, and checks the action only once.

    Args:
        action: shape (..., 6), −1…1, in the order of `SERVOS`.

    Returns:
        u★, shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape.
        WorkspaceError: NaN, or outside −1…1 by more than float32 rounding.
    """
    target = synergy_from_action(action, hand).take(hand.servo_of_joint, axis=-1)
    target *= hand.elastic_ratio
    np.maximum(target, hand.joint_min, out=target)
    np.minimum(target, hand.joint_max, out=target)
    return _servo_from_admissible_joints(target, hand)


def move_duration(servo_from: ArrayLike, servo_to: ArrayLike, hand: Hand = HPAC) -> float:
    """Duration of the synchronised move between two servo poses at the rate limit.

    The longest travel sets it and all six servos arrive together, in every task, as in the paper.

    Args:
        servo_from: shape (6,) [rad].
        servo_to: shape (6,) [rad].

    Returns:
        Duration [s], zero for no travel.

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    start = as_finite_vector(servo_from, len(SERVOS), "servo_from")
    travel = as_finite_vector(servo_to, len(SERVOS), "servo_to") - start
    return float((np.abs(travel) / hand.servo_rate_limit).max())


def streamed_servo(servo: Array, target: Array, period: float, hand: Hand = HPAC) -> Array:
    """Servo angles after one control period on the straight line to a target.

    A policy may change its target every period, so each command moves only as far along the line as
    the rate limit allows and ends exactly when the next one starts.

    Args:
        servo: last commanded angles, finite, shape (..., 6) [rad].
        target: target angles, finite, shape (..., 6) [rad].
        period: control period, positive [s].

    Returns:
        shape (..., 6) [rad].
    """
    travel = target - servo
    duration = np.maximum.reduce(np.abs(travel) / hand.servo_rate_limit, axis=-1, keepdims=True)
    return servo + period / np.maximum(duration, period) * travel


def stream_command(
    servo: ArrayLike, target: ArrayLike, period: float, hand: Hand = HPAC
) -> ServoCommand:
    """The part of a synchronised move that fits into one control period: `streamed_servo` as a
    command.

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
        WorkspaceError: `period` is not finite and positive.
    """
    _require_duration(period)
    servo = as_finite_vector(servo, len(SERVOS), "servo")
    target = as_finite_vector(target, len(SERVOS), "target")
    return ServoCommand(streamed_servo(servo, target, period, hand), period)


def minimum_jerk(share: Array | float) -> Array | float:
    """Minimum-jerk profile: fraction of the path covered after a fraction s of the duration, 10s³ −
    15s⁴ + 6s⁵, any shape.
    """
    return share**3 * (10 - 15 * share + 6 * share**2)
