"""What a picture shows: a hand, its object, and postures that can be laid over it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.model import HPAC, elastic_joints_from_servo, rigid_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import SceneState

GHOSTS = {
    "rigid": ("rigid prediction", (230, 80, 160)),
    "elastic": ("elastic prediction", (60, 190, 120)),
    "goal": ("goal", (60, 130, 240)),
}
"""Postures that can be laid over the hand: label and colour."""


@dataclass(frozen=True, slots=True)
class Shown:
    """What a picture shows."""

    joint_pos: Array
    """Joint angles, shape (15,) [rad]."""
    servo: Array
    """Commanded servo angles, of which the predictions are, shape (6,) [rad]."""
    wrist: Array
    """Offset of the wrist along the world's axes, shape (3,) [m]."""
    tension: Array | None = None
    """Tension of the driving tendons, shape (5,) [N]; None where nobody knows it."""
    object_pos: Array | None = None
    """Centre of the object in the hand's frame, shape (3,) [m]."""
    object_rotation: Rotation | None = None
    """From the object's axes to the hand's."""
    text: str = ""
    """A line below the figures."""
    goal: Array | None = None
    """Joint angles that are asked for, shape (15,) [rad]; None where none are."""

    def ghost(self, name: str) -> Array | None:
        """Joint angles of one of `GHOSTS`, shape (15,) [rad]; None without a goal."""
        if name == "goal":
            return self.goal
        predicted = rigid_joints_from_servo if name == "rigid" else elastic_joints_from_servo
        return predicted(np.clip(self.servo, HPAC.servo_min, HPAC.servo_max))

    @classmethod
    def of_state(
        cls, state: SceneState, servo: Array, text: str = "", goal: Array | None = None
    ) -> Self:
        """The first world of a simulation, the servos' commands, shape (6,) [rad], and a goal."""
        return cls(
            state.joint_pos[0],
            servo,
            state.palm_offset[0],
            state.tension[0],
            state.object_pos[0],
            Rotation.from_matrix(turn) if (turn := state.object_rotation[0]).any() else None,
            text,
            goal,
        )
