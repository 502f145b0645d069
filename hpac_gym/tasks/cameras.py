"""Simulated cameras, with a separate random stream of noise for every world."""

from collections.abc import Iterable
from dataclasses import astuple, dataclass
from math import inf

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model import JOINTS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneSetup, SceneState


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """Standard deviations of the camera's Gaussian measurement noise.

    Raises:
        ParameterError: One is negative or not finite.
    """

    position: float = 0.0015
    """Noise of each coordinate, drawn every step [m]."""
    angle: float = 0.02
    """Noise of the rotation about each axis, drawn every step [rad]."""
    size: float = 0.03
    """Relative noise of each half-extent, drawn once per episode."""

    def __post_init__(self) -> None:
        if not all(0 <= deviation < inf for deviation in astuple(self)):
            raise ParameterError(f"standard deviations of {self} must be finite and at least 0")


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
        self._position = np.zeros((num_worlds, 1))
        self._angle = np.zeros((num_worlds, 1))
        # Whether the object has a visible axis, and a visible side.
        self._shown = np.zeros((2, num_worlds, 1))
        self._half_extents = np.zeros((num_worlds, 3))
        self._draw = np.zeros((num_worlds, 6))

    def start(self, world: int, setup: SceneSetup, factor: float, rng: np.random.Generator) -> None:
        """Begin an episode of a setup, with `factor` times the noise, drawn from `rng`."""
        noise = self._noise
        shape = setup.object.shape
        self._rng[world] = rng
        self._position[world] = noise.position * factor
        self._angle[world] = noise.angle * factor
        self._half_extents[world] = np.array(setup.object.half_extents) * (
            1 + noise.size * factor * rng.standard_normal(3)
        )
        self._shown[:, world, 0] = shape != "sphere", shape == "box"

    def look(self, state: SceneState, worlds: Iterable[int]) -> dict[str, Array]:
        """Measure some worlds anew; the others keep their last noise.

        Returns:
            Measured `position` (n, 3) [m], axes `up` and `side` (n, 3), and `half_extents` (n, 3)
            [m] of the objects.
        """
        for world in worlds:
            self._draw[world] = self._rng[world].standard_normal(6)
        # Both axes in one call: at n = 1 the call overhead dominates.
        axes = state.object_rotation[:, :, [2, 0]].transpose(2, 0, 1)
        tilt = self._angle * self._draw[:, 3:]
        up, side = _tilted(axes, tilt, self._shown)
        return {
            "position": state.object_pos + self._position * self._draw[:, :3],
            "up": up,
            "side": side,
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


def _tilted(axis: Array, tilt: Array, length: Array) -> Array:
    """Axes, shape (m, n, 3), rotated by small angles, shape (n, 3) [rad], and scaled to given
    lengths, shape (m, n, 1).
    """
    seen = axis + np.einsum("ijk,nj,mnk->mni", _CROSS, tilt, axis)
    return (
        length / np.maximum(np.sqrt(np.einsum("mni,mni->mn", seen, seen))[..., None], 1e-12) * seen
    )


_CROSS = np.zeros((3, 3, 3))
"""The cross product as a tensor; for arrays this small `np.cross` takes ten times as long."""
_CROSS[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1.0
_CROSS[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = -1.0
