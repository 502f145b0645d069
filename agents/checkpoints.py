"""Checkpoints of the complete training state, from which an interrupted training continues.

A checkpoint is a folder ``checkpoint-EPISODES`` that is renamed to this name once its contents are on disk; only then is the
previous one removed. It holds JSON and plain arrays: reading it executes no foreign code.
"""

import errno
import json
import os
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.closures import Learner
from agents.command import RunError
from agents.tasks import other_versions, versions

_PREFIX = "checkpoint-"
_UNFINISHED = ".unfinished"
_TRIALS = ("seen", "decisions", "survived", "came_to")
_SCALES = ("mean", "scale", "mean_came_to", "scale_came_to")


def save_checkpoint(folder: Path, learner: Learner, state: dict[str, Any]) -> Path:
    """Write a checkpoint of the learner, its optimisers, its trials and the scaling; returns its folder.

    Raises:
        RunError: The training has diverged, the disk is full or the folder cannot be written; the previous checkpoint is kept.
    """
    trials = learner.trials
    final = folder / f"{_PREFIX}{trials.count:09d}"
    unfinished = final.with_suffix(_UNFINISHED)
    arrays = {name: getattr(learner, name) for name in _SCALES} | flattened(learner.weights())
    arrays |= {name: getattr(trials, name)[: trials.count] for name in _TRIALS}
    try:
        if bad := next((name for name, array in arrays.items() if not np.isfinite(array).all()), None):
            raise ValueError(f"the training has diverged, {bad} is not finite")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        np.savez(unfinished / "arrays.npz", **arrays)
        state = {"episodes": trials.count, "updates": learner.updates, "versions": versions(), **state}
        (unfinished / "state.json").write_text(json.dumps(state, indent=2) + "\n")
        for path in (*unfinished.iterdir(), unfinished):
            _to_disk(path)
        shutil.rmtree(final, ignore_errors=True)
        os.rename(unfinished, final)
        _to_disk(folder)
    except (OSError, ValueError) as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        kept = latest_checkpoint(folder)
        reason = getattr(error, "strerror", None) or error
        raise RunError(
            f"cannot write checkpoint '{final}': {reason}; " + (f"'{kept.name}' is kept" if kept else "there is no earlier one")
        ) from error
    for old in folder.glob(f"{_PREFIX}*"):
        if old != final:
            shutil.rmtree(old, ignore_errors=True)
    return final


def flattened(tree: Mapping[str, Any], place: str = "") -> dict[str, np.ndarray]:
    """The tensors in nested dictionaries as arrays, by path; optimisers' settings are left out, since the recipe has them."""
    arrays = {}
    for name, value in tree.items():
        if isinstance(value, torch.Tensor):
            arrays[f"{place}{name}"] = value.numpy()
        elif isinstance(value, Mapping):
            arrays |= flattened(value, f"{place}{name}/")
    return arrays


def _nested(arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    tree: dict[str, Any] = {}
    for place, array in arrays.items():
        *path, name = place.split("/")
        within = tree
        for part in path:
            within = within.setdefault(int(part) if part.isdigit() else part, {})
        within[name] = torch.from_numpy(array)
    return tree


def latest_checkpoint(folder: Path) -> Path | None:
    """The latest complete checkpoint in a folder; None without one."""
    found = [path for path in folder.glob(f"{_PREFIX}*") if path.suffix != _UNFINISHED]
    return max(found, default=None)


def saved_trials(folder: Path) -> int:
    """Number of trials in the latest complete checkpoint in a folder; 0 without one."""
    path = latest_checkpoint(folder)
    return int(path.name.removeprefix(_PREFIX)) if path else 0


def load_checkpoint(path: Path, learner: Learner) -> dict[str, Any]:
    """Load a checkpoint into a learner of the same recipe; returns the state saved with it.

    Raises:
        RunError: A file is missing or damaged, or the checkpoint is of another recipe or of other versions.
    """
    try:
        state = json.loads((path / "state.json").read_text())
        with np.load(path / "arrays.npz", allow_pickle=False) as file:
            arrays = dict(file)
        count, room = len(arrays["survived"]), len(learner.trials.survived)
        if count != state["episodes"] or count > room:
            raise ValueError(f"{count} trials, where there is room for {room}")
        if others := other_versions(state["versions"]):
            raise ValueError(f"it was written with {others}")
        trials = [arrays.pop(name) for name in _TRIALS]
        scales = {name: arrays.pop(name) for name in _SCALES}
        learner.load_weights(_nested(arrays))
        learner.trials.count = 0
        learner.trials.add(*trials)
        for name, scale in scales.items():
            setattr(learner, name, scale)
        learner.updates = state["updates"]
    except Exception as error:  # a damaged file can make its reader raise anything
        raise RunError(f"checkpoint '{path}' is damaged, of another recipe or of other versions: {error}") from error
    return state


def _to_disk(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system without fsync of folders
            raise
    finally:
        os.close(handle)
