"""Object sets for tasks with arbitrary objects: 200 procedural training objects, with 200 plain solids
beside them or not, 50 held-out ones, and real ones.

Every object has its stable poses. The procedural objects are drawn by ``tools/object_families.py``;
the poses were found by simulation (``tools/resting_poses.py``) and are stored as data."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from hpac_gym.body.geometry import table_of
from hpac_gym.body.object_models import ObjectModel, load_object_models, object_model
from hpac_gym.settings import check_choice

SPLITS = ("train", "wide", "test", "real")
"""Procedural training objects, the same and plain solids, held-out procedural objects, and real
objects; the last two are never used in training.
"""


@dataclass(frozen=True, slots=True)
class RestingPose:
    """A stable pose of an object on a level surface; its yaw is arbitrary."""

    quaternion: tuple[float, float, float, float]
    """Orientation of the object in the world, xyzw, with its longer horizontal side along x."""
    height: float
    """Height of the object's origin, the centre of its bounding box, above the surface [m]."""
    size: tuple[float, float, float]
    """Extents along the world's axes [m]."""
    share: float
    """Fraction of drops in random orientations that came to rest in this pose; 0 if it is stable
    only when placed.
    """

    @property
    def width(self) -> float:
        """Smaller horizontal extent [m]."""
        return min(self.size[:2])


@dataclass(frozen=True, slots=True)
class RestingObject:
    """An object with the data that a task needs to place it."""

    model: ObjectModel
    friction: float
    """Coulomb coefficient of its surface, to be multiplied by the skin's or the support's."""
    poses: tuple[RestingPose, ...]
    """Stable poses, the most frequent first."""
    stand: bool
    """True if it stands upright on a narrow post, which leaves room for a hand beside it; False if
    it is on the table.
    """

    @property
    def name(self) -> str:
        """Name of the object, such as `train_017`, `test_03` or that of a real object."""
        return self.model.name


def object_set(split: str) -> tuple[RestingObject, ...]:
    """Objects of a split; every call returns the same objects in the same order.

    Raises:
        ParameterError: `split` is not one of `SPLITS`.
    """
    check_choice("object split", split, SPLITS)
    return _object_sets()[split]


def split_models() -> dict[str, dict[str, tuple[ObjectModel, float]]]:
    """Objects and their friction by split and name, without poses."""
    real = table_of("real_objects.toml")
    friction = real.pop("friction_of_named_objects")
    named = {
        name: (model, friction[name])
        for name, model in load_object_models().items()
        if name in friction
    }
    drawn = _entries(table_of("procedural_objects.toml"))
    kinds = {"train": "train", "wide": ("train", "plain"), "test": "test"}
    return {
        split: {name: entry for name, entry in drawn.items() if name.startswith(kind)}
        for split, kind in kinds.items()
    } | {"real": named | _entries(real)}


@cache
def _object_sets() -> dict[str, tuple[RestingObject, ...]]:
    poses = table_of("resting_poses.toml")
    return {
        split: tuple(
            resting(model, friction, poses[name]) for name, (model, friction) in models.items()
        )
        for split, models in split_models().items()
    }


def resting(model: ObjectModel, friction: float, entry: Mapping[str, Any]) -> RestingObject:
    """An object with the stable poses given by an entry of ``data/resting_poses.toml``."""
    poses = (resting_pose(model, quaternion, share) for *quaternion, share in entry["poses"])
    return RestingObject(model, friction, tuple(poses), entry["stand"])


def resting_pose(model: ObjectModel, quaternion: Sequence[float], share: float) -> RestingPose:
    """The resting pose of an object in a given orientation, with its lowest point on the surface.

    Args:
        model: the object.
        quaternion: its orientation in the world, xyzw, of about unit length.
        share: fraction of random drops that came to rest in this pose.
    """
    x, y, z, w = turn = np.array(quaternion) / np.linalg.norm(quaternion)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    low, high = model.turned_bounds(np.eye(3) + 2 * w * cross + 2 * cross @ cross)
    return RestingPose(tuple(turn.tolist()), float(-low[2]), tuple((high - low).tolist()), share)


def _entries(table: dict[str, dict[str, Any]]) -> dict[str, tuple[ObjectModel, float]]:
    """Objects of a file and their friction."""
    return {name: (object_model(name, entry), entry["friction"]) for name, entry in table.items()}
