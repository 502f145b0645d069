"""What a deployed policy can know: its own commands, what the model predicts from them, and what a camera sees.

The hand has no joint and no force sensors, so nothing here reads the simulated joints. The layout is one table of `Field`;
the observation's bounds, its names and its documentation all come from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

import numpy as np
from gymnasium.spaces import Box
from numpy.typing import ArrayLike, NDArray

from hpac_gym.envs.phases import PHASES
from hpac_gym.model import JOINTS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.sim import SHAPES, ObjectSpec

LENGTH_UNIT = 0.05
"""Lengths in the observation are multiples of this [m], so that every entry is of the order of one."""

AXES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Field:
    """A run of entries in the observation vector."""

    name: str
    labels: tuple[str, ...]
    unit: str
    low: float
    high: float
    meaning: str



COMMAND_FIELDS = (
    Field("servo", SERVOS, "rad", 0.0, 2.0, "commanded servo angle"),
    Field("joint_pos", JOINTS, "rad", 0.0, 2.0, "joint angle that the model predicts for the command, Eqs. (12), (13)"),
)
"""What every environment tells of its own commands."""


def deployed_fields(phases: tuple[str, ...], extra: tuple[Field, ...] = ()) -> tuple[Field, ...]:
    """The table of the deployed observation, for a task's phases and with what the task adds at the end."""
    return (
        *COMMAND_FIELDS,
        Field("object_pos", AXES, "0.05 m", -4.0, 4.0, "seen centre of the object in the hand frame, from `GRASP_CENTRE`"),
        Field("object_up", AXES, "1", -1.0, 1.0, "seen z axis of the object in the hand frame; zero for a sphere"),
        Field("object_side", AXES, "1", -1.0, 1.0, "seen x axis of the object in the hand frame; zero for a sphere or cylinder"),
        Field("object_size", AXES, "0.05 m", 0.0, 2.0, "seen half extents of the object along its own axes"),
        Field("object_shape", SHAPES, "0/1", 0.0, 1.0, "which shape it is"),
        Field("down", AXES, "1", -1.0, 1.0, "direction of gravity in the hand frame, which the arm knows"),
        Field("phase", phases, "0/1", 0.0, 1.0, "what the wrist is doing"),
        Field("progress", ("time",), "1", 0.0, 1.0, "share of the episode that has passed"),
        *extra,
    )


FIELDS = deployed_fields(PHASES)
"""The table of `HPAC-Grasp-v0`."""

GRASP_CENTRE = np.array([0.045, 0.005, 0.1125])
"""Origin of `object_pos` in the hand frame [m]: in front of the knuckles."""


def space_of(fields: tuple[Field, ...]) -> Box:
    """The box that a table describes."""
    low = np.concatenate([np.full(len(field.labels), field.low) for field in fields])
    high = np.concatenate([np.full(len(field.labels), field.high) for field in fields])
    return Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def within(space: Box, values: Array) -> NDArray[np.float32]:
    """The values as an observation; what leaves the bounds (an object out of view) stays at them."""
    return np.minimum(np.maximum(values, space.low), space.high, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class CameraNoise:
    """Standard deviations of what the camera sees; all normally distributed."""

    position: float = 0.0015
    """Of each coordinate, every step [m]."""
    angle: float = 0.02
    """Of the rotation about each axis, every step [rad]."""
    size: float = 0.03
    """Of each half extent, once an episode, relative."""


class Camera:
    """Sees one object through one episode, with noise of its own random stream."""

    def __init__(self, spec: ObjectSpec, noise: CameraNoise, rng: np.random.Generator) -> None:
        self._noise, self._rng = noise, rng
        self._shape = np.array([float(spec.shape == shape) for shape in SHAPES])
        self._size = np.array(spec.half_extents) * (1 + noise.size * rng.standard_normal(3)) / LENGTH_UNIT
        self._shows_up = float(spec.shape != "sphere")
        self._shows_side = float(spec.shape == "box")

    def look(self, position: Array, rotation: Array) -> list[ArrayLike]:
        """The object's fields, in the order of `FIELDS`.

        Args:
            position: true centre in the hand frame, shape (3,) [m].
            rotation: true rotation in the hand frame, shape (3, 3).
        """
        noise = self._rng.standard_normal(6)
        side, _, up = rotation.T.tolist()
        tilt = (self._noise.angle * noise[3:]).tolist()
        return [
            (position + self._noise.position * noise[:3] - GRASP_CENTRE) / LENGTH_UNIT,
            _tilted(up, tilt, self._shows_up),
            _tilted(side, tilt, self._shows_side),
            self._size,
            self._shape,
        ]


def _tilted(axis: list[float], tilt: list[float], length: float) -> list[float]:
    """An axis turned by a small rotation [rad] and made as long as asked."""
    (x, y, z), (a, b, c) = axis, tilt
    seen = x + b * z - c * y, y + c * x - a * z, z + a * y - b * x
    scale = length / hypot(*seen)
    return [scale * value for value in seen]


def one_hot(index: int, length: int) -> Array:
    """Zeros with a one at `index`."""
    row = np.zeros(length)
    row[index] = 1.0
    return row
