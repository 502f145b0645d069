"""Eqs. (3)–(13): servo angles to joint angles and back, with a rigid tendon and with an elastic one that
the restoring springs stretch.
"""

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.errors import WorkspaceError
from hpac_gym.model.checks import Array, as_bounded_array, as_finite_array
from hpac_gym.model.files import HPAC
from hpac_gym.model.guides import included_from_chord
from hpac_gym.model.joints import JOINT_INDEX, JOINTS, SERVOS
from hpac_gym.model.parameters import Hand, unchecked_servo_from_synergy

_CMC = len(SERVOS) - 1
_REST_BAND = 1e-7
"""Below this servo angle [rad] H(u) is replaced by its limit at rest, which is more accurate there
than q/u.
"""


def synergy_from_servo(servo: ArrayLike, hand: Hand = HPAC) -> Array:
    """Angles of the six driven joints for servo angles, tendon taken as rigid.

    Eqs. (4), (5) for the fingers' MCP, Eq. (7) for the thumb's MP, Eq. (8) for CMC. The servo
    shortens the chord between the two guides; the cosine law turns the chord back into an angle.

    Args:
        servo: u, shape (..., 6) [rad].

    Returns:
        synergy, shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
        WorkspaceError: A servo angle requires a chord that no included angle has.
    """
    servo = as_finite_array(servo, len(SERVOS), "servo")
    chord = hand.rest_chord - hand.servo_radius * servo[..., :_CMC]
    cosine = (hand.guide_sum - chord**2) / hand.guide_product
    possible = (chord >= 0) & (np.abs(cosine) <= 1)
    if not possible.all():
        *_, column = where = tuple(np.argwhere(~possible)[0])
        raise WorkspaceError(
            f"servo {SERVOS[column]} = {servo[where]:.6g} rad takes the tendon past its guides; "
            f"the admissible range is [{hand.servo_min[column]:.6g}, {hand.servo_max[column]:.6g}] rad"
        )
    return unchecked_synergy_from_servo(servo, hand)


def unchecked_synergy_from_servo(servo: Array, hand: Hand) -> Array:
    """Angles of the six driven joints for servo angles that are known to lie within the servos'
    range, shape (..., 6) [rad].
    """
    chord = hand.rest_chord - hand.servo_radius * servo[..., :_CMC]
    synergy = np.empty_like(servo)
    synergy[..., :_CMC] = hand.guide_alpha - included_from_chord(
        hand.guide_sum, hand.guide_product, chord
    )
    synergy[..., _CMC] = hand.cmc_gain * servo[..., _CMC]
    return synergy


def servo_from_synergy(synergy: ArrayLike, hand: Hand = HPAC) -> Array:
    """Servo angles that put the six driven joints at given angles: the inverse of
    `synergy_from_servo`.

    Args:
        synergy: shape (..., 6) [rad].

    Returns:
        u, shape (..., 6) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
        WorkspaceError: An angle would fold the guides past each other, or open them past straight.
    """
    synergy = as_finite_array(synergy, len(SERVOS), "synergy")
    upper = hand.guide_alpha
    as_bounded_array(
        synergy[..., :_CMC], upper - np.pi, upper, SERVOS[:_CMC], "synergy", "rad", tolerance=0.0
    )
    return unchecked_servo_from_synergy(synergy, hand)


def rigid_joints_from_servo(servo: ArrayLike, hand: Hand = HPAC) -> Array:
    """Joint angles for servo angles, tendon taken as rigid: the paper's q_ideal.

    Eq. (9), computed directly rather than as H(u)u, which is 0/0 at rest.

    Args:
        servo: u, shape (..., 6) [rad].

    Returns:
        q_ideal, shape (..., 15) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
        WorkspaceError: As `synergy_from_servo`.
    """
    return synergy_from_servo(servo, hand).take(hand.servo_of_joint, axis=-1) * hand.rigid_ratio


def transmission_matrix(servo: ArrayLike, hand: Hand = HPAC) -> Array:
    """Block-sparse transmission matrix H(u), with q_ideal = H(u) u.

    Eq. (9): fifteen entries are non-zero, each a function of one servo. At rest an entry is its
    limit, the ratio times r L₀ / (d₁ d₂ sin α).

    Args:
        servo: u, shape (..., 6) [rad].

    Returns:
        H, shape (..., 15, 6) [rad/rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
        WorkspaceError: As `synergy_from_servo`.
    """
    servo = as_finite_array(servo, len(SERVOS), "servo")
    at_rest = np.full(len(SERVOS), hand.cmc_gain)
    at_rest[:_CMC] = (
        hand.servo_radius * hand.rest_chord / (hand.guide_product / 2 * np.sin(hand.guide_alpha))
    )
    moved = np.abs(servo) > _REST_BAND
    gain = np.where(moved, synergy_from_servo(servo, hand) / np.where(moved, servo, 1.0), at_rest)
    matrix = np.zeros((*servo.shape[:-1], len(JOINTS), len(SERVOS)))
    matrix[..., np.arange(len(JOINTS)), hand.servo_of_joint] = (
        gain[..., hand.servo_of_joint] * hand.rigid_ratio
    )
    return matrix


def spring_tension(joint_pos: ArrayLike, hand: Hand = HPAC) -> Array:
    """Tension of the five restoring springs.

    Eq. (10), for the thumb over its two coupled joints. No pretension: the spring of a straight
    finger is slack.

    Args:
        joint_pos: q, shape (..., 15) [rad].

    Returns:
        T_spr of thumb, index, middle, ring and pinky, shape (..., 5) [N].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    joint_pos = as_finite_array(joint_pos, len(JOINTS), "joint_pos")
    excursion = joint_pos * hand.joint_radius
    tension = [
        digit.spring_stiffness
        * excursion[..., [JOINT_INDEX[name] for name in digit.joints]].sum(axis=-1)
        for digit in hand.digits.values()
    ]
    return np.stack(tension, axis=-1)


def elastic_deviation(joint_pos: ArrayLike, hand: Hand = HPAC) -> Array:
    """Elastic deviation b(q) of each joint from its rigid-tendon angle: q_ideal − q_comp.

    Eq. (11), evaluated at the actual joint angles. Zero for MCP, MP and CMC.

    Args:
        joint_pos: q, shape (..., 15) [rad].

    Returns:
        b(q), shape (..., 15) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    joint_pos = as_finite_array(joint_pos, len(JOINTS), "joint_pos")
    return row_by_row(joint_pos, hand.deviation_matrix)


def row_by_row(vectors: Array, matrix: Array) -> Array:
    """Products of a matrix, shape (m, n), with vectors, shape (..., n) → (..., m).

    One product per row: BLAS rounds rows of a larger product differently, and results must not
    depend on the batch size."""
    product: Array = (vectors[..., None, :] @ matrix.T)[..., 0, :]
    return product


def joints_from_synergy(synergy: ArrayLike, hand: Hand = HPAC) -> Array:
    """Joint angles on the reachable manifold: the elastic map.

    Eqs. (12), (13): M q_comp = A q_root, per digit.

    Args:
        synergy: angles of the six driven joints, shape (..., 6) [rad].

    Returns:
        q_comp, shape (..., 15) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    synergy = as_finite_array(synergy, len(SERVOS), "synergy")
    return synergy.take(hand.servo_of_joint, axis=-1) * hand.elastic_ratio


def elastic_joints_from_servo(servo: ArrayLike, hand: Hand = HPAC) -> Array:
    """Joint angles for servo angles, with the tendons' elasticity: the paper's q_comp.

    Eqs. (5), (7), (8), then Eqs. (12), (13).

    Args:
        servo: u, shape (..., 6) [rad].

    Returns:
        q_comp, shape (..., 15) [rad].

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
        WorkspaceError: As `synergy_from_servo`.
    """
    return joints_from_synergy(synergy_from_servo(servo, hand), hand)
