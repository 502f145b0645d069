"""Pictures of printed tags, rendered exactly: pieces of the sheet's own print, seen by a pinhole camera,
with perspective, an uneven light, blur and noise.

It shares nothing with `hpac_gym.camera` but the file that ``hpac tags`` writes: a piece is named by
where it stands on the paper and by where the paper stands in space."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from hpac_gym.camera.sheet import draw
from hpac_gym.model.checks import Array

DOTS = 12.0
"""Resolution of the print in the pictures [dots/mm]."""
FINER = 4
"""Dots of a picture's pixel along each axis, of which the mean is taken."""


@cache
def print_of_sheet() -> np.ndarray:
    """The printed sheet, as grey values, row 0 at its upper edge."""
    with TemporaryDirectory() as folder:
        draw(Path(folder) / "sheet.png")
        printed = cv2.imread(f"{folder}/sheet.png", cv2.IMREAD_GRAYSCALE)
    return cv2.resize(printed, (round(210 * DOTS), round(297 * DOTS)), interpolation=cv2.INTER_AREA)


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of card cut out of the sheet."""

    middle: tuple[float, float]
    """On the sheet, from its lower left corner [mm]."""
    width: float
    height: float
    """[mm]"""

    def texture(self) -> np.ndarray:
        """Its print."""
        x, y = self.middle
        left, right = (round((x + side * self.width / 2) * DOTS) for side in (-1, 1))
        top, bottom = (round((297 - y + side * self.height / 2) * DOTS) for side in (-1, 1))
        return print_of_sheet()[top:bottom, left:right]


@dataclass(frozen=True, slots=True)
class Pinhole:
    """A camera that looks from a place at a place, without distortion."""

    place: Array
    """Shape (3,) [m]."""
    target: Array
    """Shape (3,) [m]."""
    up: Array
    """A direction that is upward in the picture, shape (3,)."""
    focal: float = 1000.0
    """[pixels]"""
    size: tuple[int, int] = (1280, 720)

    def pixels(self, points: Array) -> Array:
        """Where points are in the picture, shape (n, 2) for (n, 3) [m]; (0, 0) is the middle of the
        upper left pixel.
        """
        forward = (self.target - self.place) / np.linalg.norm(self.target - self.place)
        right = np.cross(forward, self.up)
        right /= np.linalg.norm(right)
        upward = np.cross(right, forward)
        away = points - self.place
        depth = away @ forward
        column = (self.size[0] - 1) / 2 + self.focal * (away @ right) / depth
        row = (self.size[1] - 1) / 2 - self.focal * (away @ upward) / depth
        return np.stack([column, row], axis=-1)

    def picture(
        self,
        pieces: list[tuple[Piece, Array, Array, Array]],
        rng: np.random.Generator,
        blur: float = 0.6,
        noise: float = 3.0,
    ) -> np.ndarray:
        """A grey picture of pieces of card.

        Args:
            pieces: each with its middle (3,) [m], and the directions (3,) in which its print's right
                and its print's top point.
            rng: generator of the noise, and of the light.
            blur: standard deviation of the blur [pixels].
            noise: standard deviation of the noise [grey values].
        """
        width, height = self.size
        picture = np.full((height, width), 110.0, dtype=np.float32)
        for piece, middle, right, top in pieces:
            half = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * (
                piece.width / 2,
                piece.height / 2,
            )
            corners = middle + 1e-3 * (half[:, :1] * right + half[:, 1:] * top)
            if np.dot(np.cross(right, top), self.place - middle) <= 0:
                continue  # the back of the card
            seen = self.pixels(corners)
            low = np.maximum(np.floor(seen.min(axis=0)).astype(int) - 1, 0)
            high = np.minimum(np.ceil(seen.max(axis=0)).astype(int) + 2, (width, height))
            if (high <= low).any():
                continue
            texture = piece.texture()
            rows, columns = texture.shape
            # The edges of the print are the outer edges of its dots, half a dot from their middles.
            edges = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows]]) - 0.5
            fine = FINER * (seen - low + 0.5) - 0.5
            way = cv2.getPerspectiveTransform(edges.astype(np.float32), fine.astype(np.float32))
            size = tuple((FINER * (high - low)).tolist())
            card = cv2.warpPerspective(texture, way, size, flags=cv2.INTER_LINEAR).astype(
                np.float32
            )
            mask = cv2.warpPerspective(np.ones_like(texture), way, size, flags=cv2.INTER_NEAREST)
            small = tuple((high - low).tolist())
            card = cv2.resize(card * mask, small, interpolation=cv2.INTER_AREA)
            mask = cv2.resize(mask.astype(np.float32), small, interpolation=cv2.INTER_AREA)
            window = picture[low[1] : high[1], low[0] : high[0]]
            window[:] = (1 - mask) * window + (25 + 0.8 * card) * mask
        # An uneven light: from 60 to 100 % across the picture, in a direction of its own.
        turn = rng.uniform(0, 2 * np.pi)
        x = np.linspace(-1, 1, width, dtype=np.float32)
        y = np.linspace(-1, 1, height, dtype=np.float32)[:, None]
        picture *= np.float32(0.8) + np.float32(0.2 / np.sqrt(2)) * (
            np.float32(np.cos(turn)) * x + np.float32(np.sin(turn)) * y
        )
        picture = cv2.GaussianBlur(picture, (0, 0), blur)
        picture += np.float32(noise) * rng.standard_normal(picture.shape, dtype=np.float32)
        return np.clip(np.rint(picture), 0, 255).astype(np.uint8)
