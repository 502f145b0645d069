"""The boxes on which objects stand: posts, walls, the table, and the post of a target."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hpac_gym.body.objects import Support
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, SceneSetup, matrix_from_quaternion

POST = Support((0.012, 0.012))
"""Support of an object whose setup has none; this post does not rotate with the object's yaw."""
TARGET_HALF_WIDTH = 0.05
"""Half the width of the post at a setup's target [m]."""
SUPPORT_FRICTION = 0.8
"""Coulomb coefficient of posts, walls and table, to be multiplied by the object's."""
TABLE_HALF_EXTENTS = (0.35, 0.35, 0.01)
"""Half-extents of the table along x, y and z [m]."""
COLORS = {
    "support": (0.55, 0.55, 0.58, 1.0),
    "table": (0.78, 0.70, 0.58, 1.0),
    "target": (0.45, 0.62, 0.48, 1.0),
}
"""Colours of posts and walls, of the table and of the target's post, RGBA."""


@dataclass(frozen=True, slots=True)
class SupportBox:
    """A box that stands in the world."""

    kind: str
    """One of `COLORS`."""
    half_extents: Array
    """Shape (3,) [m]."""
    centre: Array
    """In the world, shape (3,) [m]."""
    quaternion: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation in the world, xyzw."""


def support_boxes(
    setup: SceneSetup, matrix: Callable[[Sequence[float]], Array] = matrix_from_quaternion
) -> list[SupportBox]:
    """Boxes that support the object of a setup: posts and walls, then the table, then the target's
    post if there is a target.

    Args:
        setup: setup with an object that is not fixed.
        matrix: rotation matrix of a quaternion xyzw; an engine may pass its own, which rounds
            differently.
    """
    rotation = matrix(setup.hand_quaternion)
    centre = HAND_POSITION + rotation @ setup.position
    reach = setup.stand_height
    support = setup.support or POST
    turn = setup.object_turn[1] if setup.support else (0.0, 0.0, 0.0, 1.0)
    floor = support.table_height
    turned = matrix(turn)
    below = np.array([centre[0], centre[1], floor])
    boxes = [
        SupportBox("support", np.array(half), below + turned @ place, turn)
        for half, place in support.boxes(centre[2] - reach - floor)
    ]
    table = np.array(TABLE_HALF_EXTENTS)
    boxes.append(SupportBox("table", table, below - [0.0, 0.0, table[2]]))
    if setup.target is not None:
        x, y, z = HAND_POSITION + rotation @ setup.target - [0.0, 0.0, reach]
        half = np.array([TARGET_HALF_WIDTH, TARGET_HALF_WIDTH, (z - floor) / 2])
        boxes.append(SupportBox("target", half, np.array([x, y, (z + floor) / 2])))
    return boxes
