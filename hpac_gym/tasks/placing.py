"""Where the wrist goes for an object whose size and pose are known: one rule for all objects.

Engines move no wrist before an episode, and need not: a wrist that is elsewhere is an object, with what it stands on, that is
elsewhere in the hand's frame. A turn of the wrist about the vertical is a turn of the object the other way about the wrist.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpac_gym.body.objects import Support
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, HAND_QUATERNION, SceneSetup, matrix_from_quaternion
from hpac_gym.tasks.grasp import PALM_SURFACE, quaternion_from_rpy

TILT = np.deg2rad(16.0)
"""Of a hand above an object: so far its fingers point below the horizontal, and reach as deep as the thumb does [rad]."""
SIDE, ABOVE = HAND_QUATERNION, quaternion_from_rpy((0.0, np.pi / 2 + TILT, 0.0))
"""Orientations of the hand, xyzw: palm to the side, thumb up; palm down. Fingers point along the world's x in both."""
TALL = 0.085
"""What stands on the table is gripped from the side if it is at least so tall [m]."""
LONG = 1.25
"""What is longer than so many times its height is gripped from above."""
BOARD, BOARD_HALF_WIDTH = 0.004, (0.15, 0.15)
"""Of the board on the table that lying objects lie on: its thickness, and half of its sides [m]."""
POST_SHARE = 0.4
"""Half width of a post, as a share of the width of the object that a hand grips from the side."""
SIDE_HEIGHT = 0.06
"""Lowest place of a hand beside an object that stands on the table, above the table: half of its width [m]."""
THUMB = 0.081
"""An object in front of the palm begins farther from the wrist than the thumb that stands there, along the fingers [m]."""
THUMB_ABOVE = 0.055
"""The same of an object below the palm, horizontally [m]."""
DIGIT_DEPTH = 0.1135
"""How far below the wrist the digits of a hand above an object reach: the open thumb, and the fingers while they close [m]."""
PALM_DEPTH = 0.042
"""How far below the wrist the palm of such a hand reaches where the object is [m]."""
FINGER_END, FINGER_RADIUS = 0.195, 0.012
"""Of the straight fingers, along them from the wrist; with 3 mm to spare [m]."""
CENTRE_SIDE, CENTRE_ABOVE = 0.1125, 0.088
"""Where the fingers close best, along the fingers, horizontally from the wrist [m]."""


def extents(setup: SceneSetup) -> Array:
    """Of the box around the object's own box, along the world's axes, shape (3,) [m]."""
    return 2 * np.abs(matrix_from_quaternion(setup.object_turn[0])) @ setup.object.half_extents


def from_side(stand: bool, size: Array) -> bool:
    """Whether an object is gripped from the side; on the table it must be tall.

    Args:
        stand: whether it stands on a post.
        size: of the box around it, shape (3,) [m].
    """
    return (stand or size[2] >= TALL) and max(size[:2]) <= LONG * size[2]


def best_turn(size: Array) -> float:
    """Turn of an object about the vertical that lays its longer horizontal side across the fingers, 0 or π/2 [rad].

    Args:
        size: of the box around it before the turn, shape (3,) [m].
    """
    return 0.0 if size[1] >= size[0] else np.pi / 2


def placed(setup: SceneSetup, gap: float, stand: bool) -> SceneSetup:
    """The setup with the object where the palm wants it, and with what it stands on.

    Args:
        setup: with the object and its orientation, and that of the hand.
        gap: from the palm to an object beside it; below the palm a quarter of it, from the nearest place that is free [m].
        stand: whether the object stands on a post.
    """
    around, low = extents(setup), setup.stand_height
    if setup.hand_quaternion == SIDE:
        height = low if stand else max(low, SIDE_HEIGHT)
        centre = [CENTRE_SIDE, PALM_SURFACE + around[1] / 2 + gap, low - height]
    else:
        centre = [CENTRE_ABOVE, 0.0, _highest(CENTRE_ABOVE, around, low, stand) - gap / 4]
    return on_something(replace(setup, position=setup.hand_rotation.T @ np.array(centre)), stand)


def on_something(setup: SceneSetup, stand: bool) -> SceneSetup:
    """The setup with a post under an object that stands on one, and with a board on the table under another one."""
    if stand:
        width, depth, _ = (POST_SHARE * extents(replace(setup, yaw=0.0))).tolist()
        return replace(setup, support=Support((width, depth)) if setup.hand_quaternion == SIDE else None)
    floor = float(HAND_POSITION[2] + (setup.hand_rotation @ setup.position)[2] - setup.stand_height)
    return replace(setup, support=Support(BOARD_HALF_WIDTH, table_height=floor - BOARD))


def moved(setup: SceneSetup, way: Array, turn: float) -> SceneSetup:
    """The setup with the wrist elsewhere, as far as the open hand does not run into anything there.

    Args:
        setup: one of `placed`, in which the hand is open.
        way: of the wrist, along the world's axes, shape (3,) [m].
        turn: of the wrist about the vertical, after that [rad].
    """
    sine, cosine = np.sin(-turn), np.cos(-turn)
    x, y, z = setup.hand_rotation @ setup.position - way
    turned = replace(setup, yaw=setup.yaw - turn)
    stand = setup.support is None or setup.support.half_width != BOARD_HALF_WIDTH
    around, low = extents(turned), setup.stand_height
    forward, aside, up = cosine * x - sine * y, sine * x + cosine * y, z
    if setup.hand_quaternion == SIDE:
        forward = max(forward, THUMB + around[0] / 2)
        aside = max(aside, PALM_SURFACE + 0.002 + around[1] / 2)
        up = up if stand else min(up, low - SIDE_HEIGHT)
    else:
        forward = max(forward, THUMB_ABOVE + around[0] / 2)
        up = min(up, _highest(forward, around, low, stand))
    return on_something(replace(turned, position=setup.hand_rotation.T @ np.array([forward, aside, up])), stand)


def _highest(forward: float, around: Array, low: float, stand: bool) -> float:
    """Highest place of an object's centre below the wrist [m]: the hand comes down to the object, or its digits to the table."""
    below_fingers = FINGER_RADIUS / np.cos(TILT) + np.tan(TILT) * min(forward + around[0] / 2, FINGER_END)
    beneath_hand = -around[2] / 2 - max(PALM_DEPTH, below_fingers)
    return beneath_hand if stand else min(beneath_hand, low - DIGIT_DEPTH)
