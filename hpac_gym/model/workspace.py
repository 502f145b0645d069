"""Table I and Eq. (14): clipping of joint angles and synergies to the admissible workspace."""

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.model.checks import Array, as_finite_array
from hpac_gym.model.files import HPAC
from hpac_gym.model.joints import JOINTS, SERVOS
from hpac_gym.model.parameters import Hand


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
