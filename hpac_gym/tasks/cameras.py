"""Simulated cameras, with a separate random stream of noise for every world."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf

import numpy as np

from hpac_gym.model import JOINTS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.settings import check_bounds, setting


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """Standard deviations of the camera's Gaussian measurement noise.

    Raises:
        ParameterError: One is negative or not finite.
    """

    position: float = setting(
        0.0015, "noise of each coordinate, drawn every step [m]", bounds=(0.0, inf)
    )
    angle: float = setting(
        0.02,
        "noise of the rotation about each axis, drawn every step [rad]",
        bounds=(0.0, inf),
    )
    size: float = setting(
        0.03, "relative noise of each half-extent, drawn once per episode", bounds=(0.0, inf)
    )

    def __post_init__(self) -> None:
        check_bounds(self, "noise")


class ObjectCamera:
    """Camera that measures the pose and size of the object in each of n worlds.

    Args:
        num_worlds: n.
        noise: measurement noise.
    """

    changing = ("_rng", "_draw")

    def __init__(self, num_worlds: int, noise: CameraNoise) -> None:
        self._noise = noise
        self._rng: list[np.random.Generator | None] = [None] * num_worlds
        self._deviation = np.zeros((num_worlds, 6))
        # Whether the object has a visible axis, and a visible side.
        self._shown = np.zeros((num_worlds, 2))
        self._half_extents = np.zeros((num_worlds, 3))
        self._draw = np.zeros((num_worlds, 6))

    @property
    def error(self) -> Array:
        """Errors of the last measurement: of the positions [m] and of the rotations [rad], shape
        (n, 6).
        """
        return self._deviation * self._draw

    def start(self, world: int, setup: SceneSetup, factor: float, rng: np.random.Generator) -> None:
        """Begin an episode of a setup, with `factor` times the noise, drawn from `rng`."""
        noise = self._noise
        shape = setup.object.shape
        self._rng[world] = rng
        self._deviation[world, :3] = noise.position * factor
        self._deviation[world, 3:] = noise.angle * factor
        self._half_extents[world] = np.array(setup.object.half_extents) * (
            1 + noise.size * factor * rng.standard_normal(3)
        )
        self._shown[world] = shape != "sphere", shape == "box"

    def look(self, state: SceneState, worlds: Iterable[int]) -> dict[str, Array]:
        """Measure some worlds anew; the others keep their last noise.

        Returns:
            Measured `position` (n, 3) [m], axes `up` and `side` (n, 3), and `half_extents` (n, 3)
            [m] of the objects.
        """
        for world in worlds:
            self._draw[world] = self._rng[world].standard_normal(6)
        error = self.error
        # Both axes in one call: at n = 1 the call overhead dominates.
        axes = state.object_rotation.reshape(-1, 9).take(_AXES, axis=1)
        tilt = error.take(_TILTS, axis=1)
        seen = axes[:, 0] + (tilt[:, 0] * axes[:, 2] - tilt[:, 1] * axes[:, 1])
        square = seen * seen
        length = np.sqrt(square[..., 0] + square[..., 2] + square[..., 1])
        seen *= (self._shown / np.maximum(length, 1e-12))[..., None]
        return {
            "position": state.object_pos + error[:, :3],
            "up": seen[:, 0],
            "side": seen[:, 1],
            "half_extents": self._half_extents,
        }


class MarkerCamera:
    """Camera that measures the joint angles of n hands by their markers, as in the paper's
    experiment.

    Args:
        num_worlds: n.
        noise: standard deviation of an angle [rad].
    """

    changing = ("_rng", "_draw")

    def __init__(self, num_worlds: int, noise: float) -> None:
        self._noise = noise
        self._rng: list[np.random.Generator | None] = [None] * num_worlds
        self._deviation = np.zeros((num_worlds, 1))
        self._draw = np.zeros((num_worlds, len(JOINTS)))

    def start(self, world: int, setup: SceneSetup, factor: float, rng: np.random.Generator) -> None:
        """Begin an episode, with `factor` times the noise, drawn from `rng`."""
        self._rng[world] = rng
        self._deviation[world] = self._noise * factor

    def look(self, state: SceneState, worlds: Iterable[int]) -> dict[str, Array]:
        """Measure `joint_pos`, shape (n, 15) [rad]; worlds that are not given keep their last
        noise.
        """
        for world in worlds:
            self._draw[world] = self._rng[world].standard_normal(len(JOINTS))
        return {"joint_pos": state.joint_pos + self._deviation * self._draw}


_AXES = np.array([[[2, 5, 8], [0, 3, 6]], [[5, 8, 2], [3, 6, 0]], [[8, 2, 5], [6, 0, 3]]])
"""Entries of a rotation matrix: its z and x axes, then both with their components moved by one and
by two, of which a cross product is made.
"""
_TILTS = np.array([[[4, 5, 3]], [[5, 3, 4]]])
"""Entries of a camera's error: the tilts about each axis, moved by one and by two."""
