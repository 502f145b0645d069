"""The pose of an object in the hand's frame, from a board of tags on each of them in one picture.

Since both boards are seen at once, where the camera stands does not matter."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.camera import CameraError, opencv
from hpac_gym.camera.detection import Lens, Seen
from hpac_gym.camera.sheet import HAND, OBJECT, Tag, points
from hpac_gym.model.checks import Array

FEWEST_TAGS = 3
"""Of a board's four: fewer lie too close for its tilt, and a single small one flips."""
WORST_FIT = 2.0
"""Largest error of a board's corners in the picture, root mean square [pixels]."""
CLEAR = 1.2
"""Least ratio of the fits of the two tilts between which a small flat board leaves the choice: with
noise of 0.15 pixels the wrong one is never ahead by more than 1.07.
"""
APART = np.radians(5.0)
"""Angle between the two tilts below which the choice does not matter [rad]."""


@dataclass(frozen=True, slots=True)
class Place:
    """A rotation and a translation: ``rotation @ point + position``."""

    position: Array
    """Shape (3,) [m]."""
    rotation: Array
    """Shape (3, 3)."""

    @classmethod
    def of(cls, numbers: tuple[float, ...]) -> Self:
        """The place of x, y, z [m] and a quaternion xyzw."""
        return cls(np.array(numbers[:3]), Rotation.from_quat(numbers[3:]).as_matrix())

    def __matmul__(self, other: Self) -> Self:
        return Place(self.rotation @ other.position + self.position, self.rotation @ other.rotation)

    @property
    def inverse(self) -> Self:
        """The place undone."""
        return Place(-self.rotation.T @ self.position, self.rotation.T)


HAND_BOARD = Place(
    np.array([0.0, 0.03, -0.03]), np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
)
"""The hand's board in the hand's frame (chosen): on a plate of the arm below the wrist, facing the
thumb's side, its printed top towards the fingertips.
"""


def board_place(seen: Seen, tags: list[Tag], lens: Lens) -> Place:
    """Where a board is in the camera's frame (x right, y down, z forward).

    Raises:
        CameraError: Fewer than `FEWEST_TAGS` of its tags are seen, they do not lie as printed, or
            its tilt can be told in two ways.
    """
    cv2 = opencv()
    board = points(tags)
    visible = [id for id in board if id in seen]
    name = tags[0].label
    if len(visible) < FEWEST_TAGS:
        raise CameraError(
            f"{len(visible)} of the {len(tags)} tags of the {name}'s board are seen, {FEWEST_TAGS} are needed"
        )
    corners = np.concatenate([board[id] for id in visible])
    pixels = np.concatenate([seen[id] for id in visible])
    given = (lens.matrix, np.array(lens.distortion))
    _, turns, moves, _ = cv2.solvePnPGeneric(corners, pixels, *given, flags=cv2.SOLVEPNP_IPPE)
    fits = []
    for turn, move in zip(turns, moves, strict=True):
        turn, move = cv2.solvePnPRefineLM(corners, pixels, *given, turn, move)
        again = cv2.projectPoints(corners, turn, move, *given)[0].reshape(-1, 2)
        fits.append((float(np.sqrt(np.mean(np.sum((again - pixels) ** 2, axis=1)))), turn, move))
    fits.sort(key=lambda fit: fit[0])
    error, turn, move = fits[0]
    if error > WORST_FIT:
        raise CameraError(
            f"the {name}'s board is {error:.1f} pixels from its print, allowed {WORST_FIT:g}: is it flat, and uncut?"
        )
    tilt = Rotation.from_rotvec(turn.ravel())
    other = Rotation.from_rotvec(fits[-1][1].ravel())
    if (tilt.inv() * other).magnitude() > APART and fits[-1][0] < CLEAR * error:
        raise CameraError(f"the tilt of the {name}'s board cannot be told: bring the camera closer")
    return Place(move.ravel(), tilt.as_matrix())


def object_place(seen: Seen, lens: Lens, top: float) -> Place:
    """Where the object is in the hand's frame.

    Args:
        seen: the tags in a picture.
        lens: the camera.
        top: height of the object's board above its centre, if the lens says no other place [m].

    Raises:
        CameraError: As of `board_place`.
    """
    on_hand = Place.of(lens.hand_board) if lens.hand_board else HAND_BOARD
    flat = Place(np.array([0.0, 0.0, top]), np.eye(3))
    on_object = Place.of(lens.object_board) if lens.object_board else flat
    hand = board_place(seen, HAND, lens) @ on_hand.inverse
    return hand.inverse @ (board_place(seen, OBJECT, lens) @ on_object.inverse)
