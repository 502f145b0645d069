"""The stable poses of an object, found by letting it come to rest.

The object is dropped onto a level table in `DROPS` random orientations, and set down on each of its
six sides. The orientations in which it comes to rest are candidate poses; poses of equal heights are
merged. A pose is kept if the object returns to it from a tilt by `NUDGE` in each of eight
directions."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.body.object_models import ObjectModel
from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.physics.mjcf import INERTIA_ENTRIES, SOFTNESS
from hpac_gym.physics.mujoco.model import add_solid, exact_text, quaternion_from_matrix
from hpac_gym.physics.supports import POST, SUPPORT_FRICTION

DROPS = 40
SEED = 12
NUDGE = math.radians(5)
"""Tilt from which an object must return [rad]."""
SAME = 0.0015
"""Poses are the same if the heights of origin, centre of mass and top differ by less than this [m].
"""
MAX_POSES = 4
HIGH = 0.120
"""Least height for a side grip above a table, since the hand is 90 mm wide [m]. Lower objects that
stand upright, with their z axis vertical, get a stand."""
_SIDES = Rotation.from_rotvec(
    np.array(
        [
            [0, 0, 0],
            [math.pi, 0, 0],
            *((a * math.pi / 2, b * math.pi / 2, 0) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))),
        ]
    )
)
_STEPS = 20
"""Physics steps of 2 ms between speed checks; an object is at rest after five slow checks in a row.
"""
_ROLLING = "0.002 0.0005"
"""Torsional and rolling friction [m], without which a ball would never come to rest."""


@dataclass(frozen=True, slots=True)
class Found:
    """An orientation in which an object came to rest."""

    rotation: Array
    """Rotation from the object frame to the world frame, shape (3, 3)."""
    heights: Array
    """Heights of origin, centre of mass and top above the table, shape (3,) [m]."""

    @classmethod
    def of(cls, model: ObjectModel, rotation: Array) -> Found:
        """The pose of an object whose lowest point is on the table."""
        low, high = model.turned_bounds(rotation)
        return cls(
            rotation,
            np.array([-low[2], (rotation @ model.center_of_mass)[2] - low[2], high[2] - low[2]]),
        )

    def same_as(self, other: Found) -> bool:
        """Whether both are the same pose up to yaw and symmetries of the object."""
        return bool(np.abs(self.heights - other.heights).max() < SAME)


class Table:
    """An object in MuJoCo above a table, or above the post of a stand."""

    def __init__(self, model: ObjectModel, friction: float, post: bool = False) -> None:
        contact = f'priority="1" condim="6" friction="{SUPPORT_FRICTION * friction} {_ROLLING}" {SOFTNESS}'
        size = exact_text((*POST.half_width, 0.1)) if post else "0.5 0.5 0.1"
        floor = f'<geom type="box" size="0.5 0.5 0.01" pos="0 0 -0.4" {contact} />'
        root = Xml.fromstring(
            f"""<mujoco>
              <option timestep="0.002" cone="elliptic" />
              <asset />
              <worldbody>
                <geom type="box" size="{size}" pos="0 0 -0.1" {contact} />{floor * post}
                <body name="object">
                  <freejoint />
                  <inertial pos="{exact_text(model.center_of_mass)}" mass="{exact_text([model.mass])}"
                    fullinertia="{exact_text(model.inertia[INERTIA_ENTRIES])}" />
                </body>
              </worldbody>
            </mujoco>"""
        )
        body = root.find("worldbody/body")
        for index, solid in enumerate(model.solids):
            add_solid(root, body, index, solid, {})
        self.object = model
        self.model = mujoco.MjModel.from_xml_string(Xml.tostring(root, encoding="unicode"))
        self.data = mujoco.MjData(self.model)

    def rest(self, rotation: Array, drop: float = 0.0, seconds: float = 4.0) -> Found | None:
        """Drop the object with its lowest point at height `drop` [m]; returns its pose at rest, or
        None if it does not settle.
        """
        model = self.model
        data = self.data
        mujoco.mj_resetData(model, data)
        data.qpos[2] = drop - self.object.turned_bounds(rotation)[0][2]
        data.qpos[3:] = quaternion_from_matrix(rotation)
        still = 0
        for _ in range(round(seconds / model.opt.timestep / _STEPS)):
            mujoco.mj_step(model, data, _STEPS)
            slow = np.abs(data.qvel[:3]).max() < 2e-3 and np.abs(data.qvel[3:]).max() < 0.05
            still = still + 1 if slow and data.ncon else 0
            if still == 5:
                break
        found = Found.of(self.object, data.body("object").xmat.reshape(3, 3).copy())
        # An object that fell off the post, or over it with its cavity, is lower.
        return found if still and abs(data.qpos[2] - found.heights[0]) < SAME else None

    def keeps(self, pose: Found) -> bool:
        """Whether a pose is stable: the object stays in it, and returns to it from a tilt in each
        of eight directions.
        """

        def comes_back(turn: Rotation) -> bool:
            found = self.rest((turn * Rotation.from_matrix(pose.rotation)).as_matrix())
            return found is not None and found.same_as(pose)

        angles = np.arange(8) * math.pi / 4
        nudges = [NUDGE * np.array([math.cos(angle), math.sin(angle), 0.0]) for angle in angles]
        return all(comes_back(Rotation.from_rotvec(nudge)) for nudge in [np.zeros(3), *nudges])


def stable_poses(
    model: ObjectModel, friction: float, drops: int = DROPS
) -> list[tuple[Found, float]]:
    """The stable poses of an object on a table with the share of random drops that end in each, the
    most frequent first.
    """
    rng = np.random.default_rng([SEED, *model.name.encode()])
    table = Table(model, friction)
    # The sides first, so that equal poses are represented by these.
    sides = [(table.rest(turn.as_matrix(), 0.001), 0) for turn in _SIDES]
    dropped = [(table.rest(turn.as_matrix(), 0.02), 1) for turn in Rotation.random(drops, rng)]
    counts = _merged((found, number) for found, number in [*sides, *dropped] if found is not None)
    levelled = _merged((_levelled(model, found), number) for found, number in counts)
    kept = [(found, number / drops) for found, number in levelled if table.keeps(found)]
    return sorted(kept, key=lambda entry: -entry[1])[:MAX_POSES]


def _merged(counts: Iterable[tuple[Found, int]]) -> list[list]:
    """Equal poses joined to the first of them, with the sum of their counts."""
    poses: list[list] = []
    for found, number in counts:
        known = next((entry for entry in poses if entry[0].same_as(found)), None)
        if known is None:
            poses.append([found, number])
        else:
            known[1] += number
    return poses


def _levelled(model: ObjectModel, found: Found) -> Found:
    """The pose with an axis within 1.5 degrees of the vertical made exactly vertical, and the
    longer side along the world's x.
    """
    down = found.rotation.T @ [0.0, 0.0, -1.0]
    axis = np.zeros(3)
    axis[np.argmax(np.abs(down))] = np.sign(down[np.argmax(np.abs(down))])
    if down @ axis > math.cos(math.radians(1.5)):
        down = axis
    turn = Rotation.align_vectors([[0.0, 0.0, -1.0]], [down])[0]
    best = min(range(180), key=lambda angle: _footprint(model, turn, angle))
    return Found.of(model, (Rotation.from_euler("z", best, degrees=True) * turn).as_matrix())


def _footprint(model: ObjectModel, turn: Rotation, angle: int) -> tuple[float, float]:
    low, high = model.turned_bounds(
        (Rotation.from_euler("z", angle, degrees=True) * turn).as_matrix()
    )
    x, y = (high - low)[:2]
    return round(x * y, 7), round(-x, 5)


def poses_of(model: ObjectModel, friction: float) -> dict[str, Any]:
    """Entry of an object in ``body/data/resting_poses.toml``: its stable poses, and whether it stands
    on a post.

    Raises:
        ParameterError: The object has no stable pose.
    """
    poses = stable_poses(model, friction)
    if not poses:
        raise ParameterError(f"object {model.name} has no stable pose: it rolls, or falls over")
    on_post = Table(model, friction, post=True)
    x, y, z = model.size
    low = 1.1 * max(x, y) < z < HIGH
    raised = [
        (pose, share)
        for pose, share in poses
        if low and abs(pose.rotation[2, 2]) > 0.999 and on_post.keeps(pose)
    ]
    shares = [
        (Rotation.from_matrix(pose.rotation).as_quat(canonical=True).tolist(), share)
        for pose, share in raised or poses
    ]
    rows = [[*(round(x, 6) + 0.0 for x in turn), round(share, 3)] for turn, share in shares]
    return {"stand": bool(raised), "poses": rows}
