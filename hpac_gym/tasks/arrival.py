"""Where the hand arrives: the wrist pose that an episode's first action chooses, and what is in its
way there.

Engines keep the wrist in place, so the object, its support and the table move instead."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.model import SERVOS, joints_from_synergy, synergy_from_action
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    HAND_QUATERNION,
    SceneSetup,
    matrix_from_quaternion,
)
from hpac_gym.physics.supports import POST, support_boxes
from hpac_gym.tasks.grasp_data import NamedGrasp, quaternion_from_rpy
from hpac_gym.tasks.occlusion import SKIN, Skeleton, inside

WRIST_ACTIONS = ("grasp_x", "grasp_y", "grasp_z", "turn_x", "turn_y", "turn_z")
START = np.array([0.20, 0.0, 0.11])
"""Centre of the object in the hand frame when an episode with a free wrist begins: out of reach
[m].
"""
WRIST_CENTRE = np.array([0.06, 0.0, 0.11])
WRIST_REACH = 0.065
"""Object centre in the hand frame for a wrist action of 0, and its displacement along the hand's
axes for one of 1 [m].
"""
WRIST_TURN = 2.0
"""Component of the rotation vector from `HAND_QUATERNION`, along the hand's axes, for an action of
1 [rad].
"""
ALONG = 9
"""Points along each link at which it is compared with the support, at most 8 mm apart."""
_SKELETON = Skeleton(1)
_AROUND = np.vstack([np.zeros(3), np.eye(3), -np.eye(3)])


def out_of_reach(setup: SceneSetup, start: NamedGrasp) -> SceneSetup:
    """The setup with the open hand at the start of an episode with a free wrist, given the data that
    it was drawn from.
    """
    position = START + setup.position - start.position
    return _elsewhere(setup, np.zeros(len(SERVOS)), position, HAND_QUATERNION)


def arrived(setup: SceneSetup, action: Array) -> SceneSetup:
    """The setup requested by an episode's first action, shape (12,): hand synergy, wrist position
    and rotation.

    The object's position noise is kept, since the arm does not know it.
    """
    place, turn = np.split(action[len(SERVOS) :], 2)
    rotation = Rotation.from_quat(HAND_QUATERNION) * Rotation.from_rotvec(WRIST_TURN * turn)
    position = WRIST_CENTRE + WRIST_REACH * place + setup.position - START
    synergy = synergy_from_action(action[: len(SERVOS)], setup.hand)
    return _elsewhere(setup, synergy, position, rotation.as_quat())


def _elsewhere(
    setup: SceneSetup, synergy: Array, position: Array, quaternion: Sequence[float]
) -> SceneSetup:
    """The setup with another synergy, another object position in the hand frame, and another hand
    orientation: object, support and table move up or down.
    """
    rises = (matrix_from_quaternion(quaternion) @ position - setup.hand_rotation @ setup.position)[
        2
    ]
    support = setup.support or POST
    return replace(
        setup,
        synergy=synergy,
        position=position,
        hand_quaternion=tuple(map(float, quaternion)),
        support=replace(support, table_height=support.table_height + float(rises)),
    )


def wrist_choice(start: NamedGrasp) -> Array:
    """Last six numbers of the first action that moves the wrist to the pose of a type's data, shape
    (6,), −1…1.
    """
    turn = Rotation.from_quat(HAND_QUATERNION).inv() * Rotation.from_quat(
        quaternion_from_rpy(start.hand_rpy)
    )
    return np.concatenate(
        [(np.array(start.position) - WRIST_CENTRE) / WRIST_REACH, turn.as_rotvec() / WRIST_TURN]
    )


def in_the_way(setup: SceneSetup) -> bool:
    """True if the hand at the start of an episode has its thumb inside a finger, or penetrates the
    support of its object or the table.

    Judged by geometry: a digit that is wedged against a support stays about its joint's stop.
    """
    joint_pos = joints_from_synergy(setup.synergy, setup.hand)
    if _SKELETON.thumb_in_finger(joint_pos, 0):
        return True
    bones = HAND_POSITION + _bones(joint_pos) @ setup.hand_rotation.T
    for box in support_boxes(setup):
        own = (bones - box.centre) @ matrix_from_quaternion(box.quaternion)
        distance = np.linalg.norm(np.maximum(np.abs(own) - box.half_extents, 0.0), axis=-1)
        if (distance < SKIN * _SKELETON.radius[0]).any():
            return True
    return False


def points_in_object(setup: SceneSetup, skin: float = 0.0) -> int:
    """How many points of the hand are inside the object at the start of an episode: those along the
    axes of its links and palm, and with a `skin` others at this fraction of the radius about them.
    """
    if setup.object is None:
        return 0
    turn = setup.hand_rotation.T @ matrix_from_quaternion(setup.object_turn[0])
    bones = _bones(joints_from_synergy(setup.synergy, setup.hand))
    own = (bones - setup.position) @ turn
    offsets = _AROUND if skin else _AROUND[:1]
    around = skin * _SKELETON.radius[0][:, None, None] * offsets
    points = (own[:, :, None] + around).reshape(-1, 3)
    solids = setup.object.solid_model.solids
    return sum(int(inside(solid, points).sum()) for solid in solids)


def _bones(joint_pos: Array) -> Array:
    """Points along the axes of the hand's capsules, in the hand frame, shape (`ALONG`, m, 3) [m]."""
    first, second = (ends[0] for ends in _SKELETON.segments(joint_pos[None], np.array([0])))
    return first + np.linspace(0, 1, ALONG)[:, None, None] * (second - first)
