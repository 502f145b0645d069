"""Sets of objects for tasks that ask for any object: 200 procedural ones to train on, 50 held out, and real ones.

Every object comes with the poses in which it lies or stands by itself. The procedural objects are drawn by
``tools/object_families.py``; the poses were found by physics (``tools/resting_poses.py``) and are kept as data.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.body.object_models import FIELDS, SOURCE_FIELDS, ObjectModel, load_object_models, object_model
from hpac_gym.errors import ParameterError

SPLITS = ("train", "test", "real")
"""Procedural objects to train on, procedural ones that are held out, real ones that are never trained on."""
SPAN = 0.082
"""Width of the widest thing that the hand is asked to grip across [m]: the large variant of the puck in the named grasps."""

_DATA = Path(__file__).parent / "data"


@dataclass(frozen=True, slots=True)
class RestingPose:
    """One way in which an object stays by itself on a level surface; its turn about the vertical is arbitrary."""

    quaternion: tuple[float, float, float, float]
    """Orientation of the object in the world, xyzw. Its longer horizontal side is along x."""
    height: float
    """Of the object's origin, the middle of its bounding box, above the surface [m]."""
    size: tuple[float, float, float]
    """Extents along the world's axes [m]."""
    share: float
    """How often it came to rest like this, of all drops in random orientations; 0 if it only stays when set down so."""

    @property
    def width(self) -> float:
        """Smaller one of both horizontal extents [m]."""
        return min(self.size[:2])


@dataclass(frozen=True, slots=True)
class RestingObject:
    """An object with all that a task needs to put it somewhere."""

    model: ObjectModel
    friction: float
    """Coulomb coefficient of its surface, which the skin's and the support's multiply."""
    poses: tuple[RestingPose, ...]
    """Stable ones, the most usual first."""
    stand: bool
    """Whether it stands upright on a narrow post, so that a hand beside it has room below; otherwise it is on the table."""

    @property
    def name(self) -> str:
        """Of the object: `train_017`, `test_03`, or that of the real thing."""
        return self.model.name


def object_set(split: str) -> tuple[RestingObject, ...]:
    """The objects of a split, always the same ones in the same order.

    Raises:
        ParameterError: There is no such split.
    """
    if split not in SPLITS:
        raise ParameterError(f"split {split!r} of objects is none of {', '.join(SPLITS)}")
    return _object_sets()[split]


def difference(one: ObjectModel, other: ObjectModel) -> float:
    """How much two objects differ in what they differ most: a side, shortest to longest, or the mass; 0.1 is 10 %."""
    measures = np.array([[*sorted(model.size), model.mass] for model in (one, other)])
    return float((measures.max(axis=0) / measures.min(axis=0)).max() - 1)


def split_models() -> dict[str, dict[str, tuple[ObjectModel, float]]]:
    """Objects and their friction by split and name, without poses."""
    drawn = _table("procedural_objects.toml")
    real = _table("real_objects.toml")
    friction = real.pop("friction_of_named_objects")
    named = {name: (model, friction[name]) for name, model in load_object_models().items() if name in friction}
    return {
        "train": {name: _entry(name, entry, FIELDS) for name, entry in drawn.items() if name.startswith("train")},
        "test": {name: _entry(name, entry, FIELDS) for name, entry in drawn.items() if name.startswith("test")},
        "real": named | {name: _entry(name, entry, FIELDS | SOURCE_FIELDS) for name, entry in real.items()},
    }


@cache
def _object_sets() -> dict[str, tuple[RestingObject, ...]]:
    poses = _table("resting_poses.toml")
    return {
        split: tuple(resting(model, friction, poses[name]) for name, (model, friction) in models.items())
        for split, models in split_models().items()
    }


def resting(model: ObjectModel, friction: float, entry: Mapping[str, Any]) -> RestingObject:
    """An object with the poses that an entry of ``data/resting_poses.toml`` says."""
    poses = tuple(resting_pose(model, tuple(numbers[:4]), numbers[4]) for numbers in entry["poses"])
    return RestingObject(model, friction, poses, entry["stand"])


def resting_pose(model: ObjectModel, quaternion: tuple[float, float, float, float], share: float) -> RestingPose:
    """A pose of an object that lies on its lowest point.

    Args:
        model: the object.
        quaternion: its orientation in the world, xyzw, of about unit length.
        share: how often it came to rest like this.
    """
    x, y, z, w = turn = np.array(quaternion) / np.linalg.norm(quaternion)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    low, high = model.turned_bounds(np.eye(3) + 2 * w * cross + 2 * cross @ cross)
    return RestingPose(tuple(turn.tolist()), float(-low[2]), tuple((high - low).tolist()), share)


def _entry(name: str, entry: dict[str, Any], fields: set[str]) -> tuple[ObjectModel, float]:
    friction = entry.pop("friction")
    return object_model(name, entry, fields), friction


def _table(name: str) -> dict[str, Any]:
    return tomllib.loads((_DATA / name).read_text(encoding="utf-8"))
