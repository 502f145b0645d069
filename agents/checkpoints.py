"""Checkpoints of the complete training state, from which an interrupted training continues.

A checkpoint is a folder ``checkpoint-EPISODES`` that is renamed to this name once its contents are on disk; only then is the
previous one removed.
"""

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch

from agents.closures import Learner
from agents.command import RunError

_PREFIX = "checkpoint-"
_UNFINISHED = ".unfinished"
_TRIALS = ("seen", "decisions", "survived", "came_to")
_SCALES = ("mean", "scale", "mean_came_to", "scale_came_to")


def save_checkpoint(folder: Path, learner: Learner, state: dict[str, Any]) -> Path:
    """Write a checkpoint of the learner, its optimisers, its trials and the scaling; returns its folder.

    Raises:
        RunError: The disk is full or the folder cannot be written; the previous checkpoint is kept.
    """
    trials = learner.trials
    final = folder / f"{_PREFIX}{trials.count:09d}"
    unfinished = final.with_suffix(_UNFINISHED)
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        torch.save(learner.weights(), unfinished / "weights.pt")
        arrays = {name: getattr(trials, name)[: trials.count] for name in _TRIALS}
        np.savez(unfinished / "arrays.npz", **{name: getattr(learner, name) for name in _SCALES}, **arrays)
        state = {"episodes": trials.count, "updates": learner.updates, **state}
        (unfinished / "state.json").write_text(json.dumps(state, indent=2) + "\n")
        for path in (*unfinished.iterdir(), unfinished):
            _to_disk(path)
        shutil.rmtree(final, ignore_errors=True)
        os.rename(unfinished, final)
        _to_disk(folder)
    except (OSError, RuntimeError) as error:  # PyTorch turns a failed write into a RuntimeError
        shutil.rmtree(unfinished, ignore_errors=True)
        kept = latest_checkpoint(folder)
        reason = getattr(error, "strerror", None) or f"{error}".splitlines()[0]
        raise RunError(
            f"cannot write checkpoint '{final}': {reason}; " + (f"'{kept.name}' is kept" if kept else "there is no earlier one")
        ) from error
    for old in folder.glob(f"{_PREFIX}*"):
        if old != final:
            shutil.rmtree(old, ignore_errors=True)
    return final


def latest_checkpoint(folder: Path) -> Path | None:
    """The latest complete checkpoint in a folder; None without one."""
    found = [path for path in folder.glob(f"{_PREFIX}*") if path.suffix != _UNFINISHED]
    return max(found, default=None)


def load_checkpoint(path: Path, learner: Learner) -> dict[str, Any]:
    """Load a checkpoint into a learner of the same recipe; returns the state saved with it.

    Raises:
        RunError: A file is missing, damaged, or of another recipe.
    """
    try:
        state = json.loads((path / "state.json").read_text())
        weights = torch.load(path / "weights.pt", weights_only=True)
        arrays = np.load(path / "arrays.npz", allow_pickle=False)
        count, room = len(arrays["survived"]), len(learner.trials.survived)
        if count != state["episodes"] or count > room:
            raise ValueError(f"{count} trials, where there is room for {room}")
        learner.load_weights(weights)
        learner.trials.count = 0
        learner.trials.add(*(arrays[name] for name in _TRIALS))
        for name in _SCALES:
            setattr(learner, name, arrays[name])
        learner.updates = state["updates"]
    except Exception as error:  # a damaged file can make its reader raise anything
        raise RunError(f"checkpoint '{path}' is damaged or of another recipe: {error}") from error
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
