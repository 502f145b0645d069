"""Pictures without a display."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pybullet
from numpy.typing import ArrayLike, NDArray

from hpac_gym.sim.world import World


@dataclass(frozen=True, slots=True)
class Camera:
    """Where the picture is taken from, and how large it is.

    Raises:
        ValueError: A size or distance that is not positive.
    """

    width: int = 480
    """[px]"""
    height: int = 360
    """[px]"""
    distance: float = 0.31
    """From the target [m]."""
    yaw_deg: float = 160.0
    pitch_deg: float = -20.0
    field_of_view_deg: float = 42.0

    def __post_init__(self) -> None:
        if not (self.width > 0 and self.height > 0 and self.distance > 0):
            raise ValueError(f"camera size {self.width}×{self.height} px and distance {self.distance} m must be positive")

    def picture(self, world: World, target: ArrayLike) -> NDArray[np.uint8]:
        """Render the world with PyBullet's software renderer.

        Args:
            world: what to look at.
            target: where to look, shape (3,) [m].

        Returns:
            RGB, shape (height, width, 3).
        """
        view = pybullet.computeViewMatrixFromYawPitchRoll(
            list(target), self.distance, self.yaw_deg, self.pitch_deg, 0.0, 2
        )
        projection = pybullet.computeProjectionMatrixFOV(self.field_of_view_deg, self.width / self.height, 0.02, 3.0)
        pixels = pybullet.getCameraImage(
            self.width,
            self.height,
            view,
            projection,
            lightDirection=[0.5, 0.8, 1.0],
            shadow=1,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=world.client,
        )[2]
        return np.reshape(np.asarray(pixels, dtype=np.uint8), (self.height, self.width, 4))[:, :, :3]
