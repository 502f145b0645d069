"""The benchmark's protocol: the splits of every environment, budgets, numbers of runs and episodes."""

import hashlib
import json
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from hpac_gym.body.object_sets import object_set
from hpac_gym.envs.commands import FILES
from hpac_gym.envs.options import CALIBRATED
from hpac_gym.errors import EnvError, HpacError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.policies.made_for import made_for
from hpac_gym.registration import GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE
from hpac_gym.tasks.grasp_rules import data_text

SCHEMA = "hpac-benchmark-1"
BUDGETS = (0, 100_000, 1_000_000, 10_000_000)
"""Permitted budgets of environment steps per training; 0 means untrained."""
RUNS = 5
EPISODES = 1_000
"""Required runs of a trained method and episodes per cell."""
CALIBRATED_HANDS = "real objects, held-out hands, calibrated"
ADDED: dict[str, tuple[str, ...]] = {GRASP_ANY: (CALIBRATED_HANDS,)}
"""Splits that an id was given later. A file from before has the hash of a definition without them,
and stays valid as a partial one; `hpac benchmark` adds their cells to it.
"""
_TWIN = {"engine": "mujoco", "body": "twin"}
_REAL = _TWIN | {"objects": "real"}
_TYPES = _TWIN | {"types": "train", "objects": "train"}
_HANDS = _TWIN | {"randomize": "hand"}
_PRIMITIVES = {
    "nominal": _TWIN,
    "hands that differ": _HANDS,
    "all that differs": _TWIN | {"randomize": "full"},
    "light body": _TWIN | {"body": "light"},
    "PyBullet": _TWIN | {"engine": "pybullet"},
}
SPLITS: dict[str, dict[str, dict[str, str]]] = {
    GRASP: _PRIMITIVES,
    PICK_PLACE: _PRIMITIVES,
    GRASP_ANY: {
        "training objects": _TWIN | {"objects": "train"},
        "held-out objects": _TWIN | {"objects": "test"},
        "real objects": _REAL,
        "real objects, training hands": _REAL | {"hands": "train"},
        "real objects, held-out hands": _REAL | {"hands": "test"},
        CALIBRATED_HANDS: _REAL | {"hands": "test", "model": CALIBRATED},
        "real objects, light body": _REAL | {"body": "light"},
        "real objects, PyBullet": _REAL | {"engine": "pybullet"},
    },
    GRASP_TYPE: {
        "training types and objects": _TYPES,
        "held-out objects": _TYPES | {"objects": "test"},
        "held-out types": _TYPES | {"types": "test"},
        "held-out types and objects": _TYPES | {"types": "test", "objects": "test"},
        "hands that differ": _TYPES | {"randomize": "hand"},
        "light body": _TYPES | {"body": "light"},
        "PyBullet": _TYPES | {"engine": "pybullet"},
    },
    POSTURE: {
        "hands that differ": _HANDS,
        "nominal": _TWIN | {"randomize": "nominal"},
        "all that differs": _TWIN | {"randomize": "full"},
        "light body": _HANDS | {"body": "light"},
        "PyBullet": _HANDS | {"engine": "pybullet"},
    },
}
"""Options of the environment in each split, by id; each split changes one factor."""

Results = dict[str, Any]


class ResultsError(HpacError, OSError):
    """A results file cannot be read, written or continued."""


def splits_of(env_id: str) -> dict[str, dict[str, str]]:
    """The splits of an id.

    Raises:
        EnvError: The environment has no benchmark.
    """
    if env_id not in SPLITS:
        raise EnvError(f"environment '{env_id}' has no benchmark: known are {', '.join(SPLITS)}")
    return SPLITS[env_id]


@cache
def env_hash(env_id: str, without: Sequence[str] = ()) -> str:
    """SHA-256 of the definition of a benchmark environment: splits, observation, task, hand,
    objects, and the files of calibrated hands; `without` names splits that it leaves out.
    """
    splits = {split: of for split, of in splits_of(env_id).items() if split not in without}
    with make_env(env_id, **next(iter(splits.values()))) as env:
        told: Results = {"splits": splits, "made_for": made_for(env)}
    if env_id == GRASP_TYPE:
        told["types"] = data_text()
    if any(options.get("model") == CALIBRATED for options in splits.values()):
        told["calibrated"] = [path.read_text("utf-8") for path in sorted(FILES.glob("*.toml"))]
    for name in (
        sorted({options["objects"] for options in splits.values()}) if env_id == GRASP_ANY else ()
    ):
        told[name] = [
            [
                entry.name,
                entry.friction,
                float(entry.model.mass),
                np.round([pose.quaternion for pose in entry.poses], 9).tolist(),
            ]
            for entry in object_set(name)
        ]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def judged_splits(results: Results) -> list[str]:
    """The splits that a results file has, in order."""
    left_out = lacking(results)
    return [split for split in splits_of(results["env_id"]) if split not in left_out]


def lacking(results: Results) -> list[str]:
    """The splits that a results file lacks: those it says it left out, and those that were added
    after it was made.
    """
    return [
        *results.get("left_out", []),
        *(ADDED[results["env_id"]] if from_before(results) else ()),
    ]


def from_before(results: Results) -> bool:
    """Whether a results file is from before its environment was given more splits."""
    added = ADDED.get(results["env_id"], ())
    return bool(added) and results.get("env_sha256") == env_hash(results["env_id"], added)
