"""Angles of a digit's joints from the tags of its strip, over all the pictures of one sweep.

The tags stand square to the joints' common axis and turn in their planes before a camera that stands
still and looks along that axis. One fit to all pictures finds the axis and how far each tag leans from
square; then a picture leaves four unknowns a tag, its place and its turn, for eight measured numbers.
A turn in the picture's plane is what a camera sees best, and it does not flip."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hpac_gym.camera import CameraError
from hpac_gym.camera.detection import Lens, Seen, rays
from hpac_gym.camera.sheet import Tag
from hpac_gym.model.checks import Array

LEAN = np.radians(4.0)
"""How well tags are glued square to the axis: standard deviation that the fit assumes (chosen) [rad]."""
CORNER = 0.1
"""Deviation of a corner that the fit assumes [pixels]."""
FITTED = 60
"""Pictures to which axis and leans are fitted."""
FEWEST = 10
"""Least number of pictures that show all tags."""
WORST_FIT = 0.7
"""Largest error of a tag's corners, root mean square, that is taken [pixels]."""
BASE_STILL = np.radians(8.0)
"""Furthest turn of the tag that stands still [rad]."""
_ASKEW = 0.35
"""First guesses of the angle between the axis and the camera's own: on four sides [rad]."""
_STEPS = 6
_FACING = np.diag([1.0, -1.0, -1.0])
"""A tag that faces the camera, upright, in the camera's frame (x right, y down, z forward)."""


def turns(
    pictures: Sequence[Seen], tags: Sequence[Tag], lens: Lens, at_rest: Array
) -> tuple[Array, float]:
    """Angles of a digit's joints in the pictures of one sweep.

    The direction of flexion is that in which the last tag turns.

    Args:
        pictures: the tags in each picture.
        tags: the strip, that which stands still first.
        lens: the camera.
        at_rest: which pictures show the digit at rest, shape (pictures,).

    Returns:
        Angles of the joints, zero at rest, from the palm outwards, shape (pictures, tags − 1) [rad],
        NaN where a tag is not seen; and the median error of a tag's corners, root mean square
        [pixels].

    Raises:
        CameraError: Too few pictures show all tags, their corners do not fit, or the tag that must
            stand still turns.
    """
    hidden = np.full((4, 2), np.nan)
    pixels = np.array([[seen.get(tag.id, hidden) for tag in tags] for seen in pictures])
    whole = np.flatnonzero(~np.isnan(pixels).any(axis=(1, 2, 3)))
    if len(whole) < FEWEST:
        counts = (~np.isnan(pixels[:, :, 0, 0])).sum(axis=0) if len(pictures) else [0] * len(tags)
        told = ", ".join(f"{tag.label} {count}" for tag, count in zip(tags, counts, strict=True))
        raise CameraError(
            f"{len(whole)} pictures show all tags of the strip, {FEWEST} are needed; of {len(pictures)}: {told}"
        )
    seen = rays(pixels, lens)
    half = np.array([tag.size for tag in tags]) / 2 * 1e-3
    few = seen[whole[np.linspace(0, len(whole) - 1, min(FITTED, len(whole))).round().astype(int)]]
    scale = np.mean(lens.focal)

    def off(numbers: Array) -> Array:
        _, error = _turned(few, half, numbers)
        return np.concatenate([error.ravel() * scale / CORNER, numbers[2:] / LEAN])

    starts = _ASKEW * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]])
    fits = [least_squares(off, np.append(s, np.zeros(2 * len(tags))), x_scale=0.1) for s in starts]
    best = min(fits, key=lambda fit: fit.cost)
    turn, error = _turned(seen, half, best.x)
    error = scale * np.sqrt((error**2).sum(axis=-1).mean(axis=-1))
    misfit = float(np.nanmedian(error))
    if misfit > WORST_FIT:
        raise CameraError(
            f"the tags of the strip are {misfit:.2f} pixels from a turn about one axis, allowed {WORST_FIT}: "
            "do camera and stand stand still, and are the tags square to the axis?"
        )
    turn = np.where(error <= WORST_FIT, turn, np.nan)
    for place, unseen in enumerate(np.isnan(turn[at_rest]).all(axis=0)):
        if unseen:
            raise CameraError(f"tag {tags[place].id} ({tags[place].label}) is not seen at rest")
    turn = _wrapped(turn - np.nanmedian(turn[at_rest], axis=0))
    still = float(np.ptp(np.nanquantile(turn[:, 0], (0.02, 0.98))))
    if still > BASE_STILL:
        raise CameraError(
            f"tag {tags[0].id} ({tags[0].label}) must stand still and turns by {np.degrees(still):.0f}°: are tags exchanged?"
        )
    joint_pos = _wrapped(np.diff(turn, axis=1))
    total = np.nansum(joint_pos, axis=1)
    sign = np.sign(total[np.argmax(np.abs(total))]) or 1.0
    return sign * joint_pos, misfit


def _turned(seen: Array, half: Array, numbers: Array) -> tuple[Array, Array]:
    """Turn of each tag about the axis, and what is left at its corners.

    Gauss and Newton, all tags of all pictures at once.

    Args:
        seen: rays of the corners, shape (pictures, tags, 4, 2).
        half: half sides of the tags, shape (tags,) [m].
        numbers: two of the axis, as a rotation from the camera's, and two of each tag's lean [rad].

    Returns:
        Shape (pictures, tags) [rad], and (pictures, tags, 4, 2) as rays.
    """
    square = np.array([[-1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]])
    axis = _FACING @ Rotation.from_rotvec([*numbers[:2], 0.0]).as_matrix()
    lean = Rotation.from_rotvec(np.pad(numbers[2:].reshape(-1, 2), ((0, 0), (0, 1)))).as_matrix()
    corners = np.einsum("tij,tcj->tci", lean[..., :2], half[:, None, None] * square)
    edge = seen[..., 1, :] - seen[..., 0, :] + seen[..., 2, :] - seen[..., 3, :]
    turn = np.arctan2(-edge[..., 1], edge[..., 0])
    depth = 4 * half / np.linalg.norm(edge, axis=-1)
    place = np.concatenate([seen.mean(axis=-2), np.ones_like(depth)[..., None]], axis=-1)
    place *= depth[..., None]
    for step in range(_STEPS + 1):
        cos = np.cos(turn)[..., None]
        sin = np.sin(turn)[..., None]
        x, y, z = np.moveaxis(corners, -1, 0)
        z = np.broadcast_to(z, (*turn.shape, 4))
        spun = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
        moved = np.stack([-spun[..., 1], spun[..., 0], np.zeros_like(z)], axis=-1)
        point = place[..., None, :] + spun @ axis.T
        deep = point[..., 2, None, None]
        flat = point[..., :2] / deep[..., 0]
        if step == _STEPS:
            break
        # How a ray changes with its point, and this with the four unknowns.
        right_and_down = np.broadcast_to(np.eye(2), (*z.shape, 2, 2))
        of_place = np.concatenate([right_and_down, -flat[..., None]], axis=-1) / deep
        of_turn = of_place @ (moved @ axis.T)[..., None]
        rate = np.concatenate([of_turn, of_place], axis=-1).reshape(*turn.shape, 8, 4)
        rate = np.where(np.isnan(rate).any(axis=(-1, -2), keepdims=True), np.eye(8, 4), rate)
        left = np.swapaxes(rate, -1, -2)
        change = np.linalg.solve(left @ rate, left @ (flat - seen).reshape(*turn.shape, 8, 1))
        turn = turn - change[..., 0, 0]
        place = place - change[..., 1:, 0]
    return turn, flat - seen


def _wrapped(angle: Array) -> Array:
    """An angle within half a turn [rad]."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
