"""Wrist placement: for an object of known size and pose, by one rule for all objects, and where the
first action of an episode asks for it.

Engines do not move the wrist before an episode. Instead, the object and its support are displaced
in the hand's frame, and a rotation of the wrist about the vertical becomes the opposite rotation of
the object about the wrist."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry, link_poses
from hpac_gym.body.hands import HandVariant
from hpac_gym.body.objects import Support
from hpac_gym.model import (
    FINGERS,
    HPAC,
    JOINT_INDEX,
    SERVOS,
    Hand,
    joints_from_synergy,
    synergy_from_action,
)
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    HAND_QUATERNION,
    SceneSetup,
    matrix_from_quaternion,
)
from hpac_gym.physics.supports import POST
from hpac_gym.tasks.grasp import PALM_SURFACE
from hpac_gym.tasks.grasp_data import NamedGrasp, quaternion_from_rpy

TILT = np.deg2rad(16.0)
"""Downward tilt of the fingers of a hand above an object, at which they reach as deep as the thumb
[rad].
"""
SIDE = HAND_QUATERNION
ABOVE = quaternion_from_rpy((0.0, np.pi / 2 + TILT, 0.0))
"""Orientations of the hand, xyzw: palm to the side, thumb up; palm down. Fingers point along the
world's x in both.
"""
TALL = 0.085
"""Least height of an object on the table that is gripped from the side [m]."""
LONG = 1.25
"""Ratio of length to height above which an object is gripped from above."""
BOARD = 0.004
BOARD_HALF_WIDTH = (0.15, 0.15)
"""Board on the table under lying objects: thickness, and half of its sides [m]."""
POST_SHARE = 0.4
"""Half-width of a post as a fraction of the width of the object on it."""
SIDE_HEIGHT = 0.06
"""Least height above the table of a hand beside an object: half of the hand's width [m]."""
THUMB = 0.081
"""Least distance along the fingers from the wrist to an object in front of the palm, so that it
clears the thumb [m].
"""
THUMB_ABOVE = 0.055
"""The same, measured horizontally, for an object below the palm [m]."""
DIGIT_DEPTH = 0.1135
"""Depth below the wrist that the digits of a hand above an object reach: the open thumb, and the
closing fingers [m].
"""
PALM_DEPTH = 0.042
"""Depth below the wrist that the palm of such a hand reaches at the object [m]."""
FINGER_END = 0.195
FINGER_RADIUS = 0.012
"""Distance from the wrist to the tips of the straight fingers, and the fingers' radius, with 3 mm
clearance [m].
"""
CENTRE_SIDE = 0.1125
CENTRE_ABOVE = 0.088
"""Best object position for closing, along the fingers, as horizontal distance from the wrist [m].
"""

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


@dataclass(frozen=True, slots=True)
class Reach:
    """By how much the open hand reaches farther than the nominal one [m]; never negative."""

    forward: float = 0.0
    """Of the thumb, horizontally along the fingers, beside or above an object."""
    down: float = 0.0
    """Of the thumb, below the wrist of a hand above an object."""
    fingers: float = 0.0
    """Radius of the fingers."""


NOMINAL_REACH = Reach()


def reach_of(variant: HandVariant, synergy: Array) -> Reach:
    """The reach of a hand that starts in a posture, shape (6,) [rad], and whose servos then move it
    to their own zeros.
    """
    starts = (synergy, synergy + variant.servo_zero)
    views = (SIDE, ABOVE)
    reached = np.array(
        [
            [_thumb(variant.geometry, variant.hand, start, view) for start in starts]
            for view in views
        ]
    )
    more = reached - np.array([[_thumb(HPAC_GEOMETRY, HPAC, synergy, view)] for view in views])
    thicker = [
        phalanx.capsule.radius - usual.capsule.radius
        for name in FINGERS
        for phalanx, usual in zip(
            variant.geometry.digit(name).phalanges, HPAC_GEOMETRY.digit(name).phalanges, strict=True
        )
    ]
    return Reach(
        max(0.0, float(more[..., 0].max())),
        max(0.0, float(more[1, :, 1].max())),
        max(0.0, *thicker),
    )


def _thumb(geometry: Geometry, hand: Hand, synergy: Array, quaternion: tuple[float, ...]) -> Array:
    """How far forward and down the thumb reaches from the wrist, shape (2,) [m]."""
    joints = joints_from_synergy(synergy, hand)
    digit = geometry.digit("thumb")
    rotation = matrix_from_quaternion(quaternion)
    poses = link_poses(digit, [joints[JOINT_INDEX[phalanx.joint]] for phalanx in digit.phalanges])
    capsules = [phalanx.capsule for phalanx in digit.phalanges]
    ends = np.array(
        [
            rotation @ (place + turn @ capsule.end)
            for (place, turn), capsule in zip(poses, capsules, strict=True)
        ]
    )
    radii = np.array([capsule.radius for capsule in capsules])
    return np.array([(ends[:, 0] + radii).max(), (radii - ends[:, 2]).max()])


def extents(setup: SceneSetup) -> Array:
    """Extents of the object's bounding box along the world's axes, shape (3,) [m]."""
    return 2 * np.abs(matrix_from_quaternion(setup.object_turn[0])) @ setup.object.half_extents


def placed(setup: SceneSetup, gap: float, stand: bool, reach: Reach = NOMINAL_REACH) -> SceneSetup:
    """The setup with the object at its nominal place relative to the palm, and with its support.

    Args:
        setup: setup with the object and the orientations of object and hand.
        gap: distance from the palm to an object beside it; below the palm, a quarter of it is added
            to the least clearance [m].
        stand: whether the object stands on a post.
        reach: reach of the hand.
    """
    around = extents(setup)
    low = setup.stand_height
    if setup.hand_quaternion == SIDE:
        height = low if stand else max(low, SIDE_HEIGHT)
        centre = [CENTRE_SIDE, PALM_SURFACE + around[1] / 2 + gap, low - height]
    else:
        centre = [CENTRE_ABOVE, 0.0, _highest(CENTRE_ABOVE, around, low, stand, reach) - gap / 4]
    return on_something(replace(setup, position=setup.hand_rotation.T @ np.array(centre)), stand)


def on_something(setup: SceneSetup, stand: bool) -> SceneSetup:
    """The setup with a post under an object that stands on one, and a board on the table under any
    other object.
    """
    if stand:
        width, depth, _ = (POST_SHARE * extents(replace(setup, yaw=0.0))).tolist()
        return replace(
            setup, support=Support((width, depth)) if setup.hand_quaternion == SIDE else None
        )
    floor = float(HAND_POSITION[2] + (setup.hand_rotation @ setup.position)[2] - setup.stand_height)
    return replace(setup, support=Support(BOARD_HALF_WIDTH, table_height=floor - BOARD))


def moved(setup: SceneSetup, way: Array, turn: float, reach: Reach = NOMINAL_REACH) -> SceneSetup:
    """The setup with the wrist moved, limited to places where the open hand does not collide.

    Args:
        setup: setup from `placed`, in which the hand is open.
        way: displacement of the wrist along the world's axes, shape (3,) [m].
        turn: subsequent rotation of the wrist about the vertical [rad].
        reach: reach of the hand.
    """
    sine = np.sin(-turn)
    cosine = np.cos(-turn)
    x, y, z = setup.hand_rotation @ setup.position - way
    turned = replace(setup, yaw=setup.yaw - turn)
    stand = setup.support is None or setup.support.half_width != BOARD_HALF_WIDTH
    around = extents(turned)
    low = setup.stand_height
    forward = cosine * x - sine * y
    aside = sine * x + cosine * y
    up = z
    if setup.hand_quaternion == SIDE:
        forward = max(forward, THUMB + reach.forward + around[0] / 2)
        aside = max(aside, PALM_SURFACE + 0.002 + around[1] / 2)
        up = up if stand else min(up, low - SIDE_HEIGHT)
    else:
        forward = max(forward, THUMB_ABOVE + reach.forward + around[0] / 2)
        up = min(up, _highest(forward, around, low, stand, reach))
    there = replace(turned, position=setup.hand_rotation.T @ np.array([forward, aside, up]))
    return there if stand else on_something(there, False)


def _highest(forward: float, around: Array, low: float, stand: bool, reach: Reach) -> float:
    """Highest z of an object's centre relative to the wrist [m], limited by the hand on the object
    or its digits on the table.
    """
    below_fingers = (FINGER_RADIUS + reach.fingers) / np.cos(TILT) + np.tan(TILT) * min(
        forward + around[0] / 2, FINGER_END
    )
    beneath_hand = -around[2] / 2 - max(PALM_DEPTH, below_fingers)
    return beneath_hand if stand else min(beneath_hand, low - DIGIT_DEPTH - reach.down)


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
