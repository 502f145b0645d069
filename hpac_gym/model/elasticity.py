"""Eqs. (10)–(13): effect of the restoring springs and of tendon elasticity on the joint angles."""

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model.checks import Array, as_finite_array
from hpac_gym.model.files import HPAC
from hpac_gym.model.joints import JOINT_INDEX, JOINTS, SERVOS
from hpac_gym.model.parameters import Hand
from hpac_gym.model.transmission import synergy_from_servo


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
