"""Saving a training whole, so that a killed one goes on from its last checkpoint.

A checkpoint is a folder ``checkpoint-STEPS`` that gets its name by one rename, when everything in it has reached the
disk; the one before is removed only then.
"""

import errno
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import SAC

from agents.errors import RunError

_PREFIX = "checkpoint-"
_UNFINISHED = ".unfinished"
_TRANSITION = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


def save_checkpoint(folder: Path, model: SAC, state: dict[str, Any]) -> Path:
    """Write a checkpoint of the learner, its optimisers, its replay buffer and the scaling; returns its folder.

    Raises:
        RunError: The disk is full or the folder cannot be written; the checkpoint before is still there.
    """
    final = folder / f"{_PREFIX}{model.num_timesteps:09d}"
    unfinished = final.with_suffix(_UNFINISHED)
    try:
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        torch.save(_weights(model), unfinished / "weights.pt")
        np.savez(unfinished / "arrays.npz", **_buffer_arrays(model), **_scaling_arrays(model))
        state = {"steps": model.num_timesteps, "updates": model._n_updates, "episodes": model._episode_num, **state}
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
            f"cannot write checkpoint '{final}': {reason}; " + (f"'{kept.name}' is kept" if kept else "there is none before")
        ) from error
    for old in folder.glob(f"{_PREFIX}*"):
        if old != final:
            shutil.rmtree(old, ignore_errors=True)
    return final


def latest_checkpoint(folder: Path) -> Path | None:
    """The checkpoint of the most steps in a folder; unfinished ones do not count."""
    found = [path for path in folder.glob(f"{_PREFIX}*") if path.suffix != _UNFINISHED]
    return max(found, default=None)


def load_checkpoint(path: Path, model: SAC) -> dict[str, Any]:
    """Put a checkpoint into a learner that was made by the same recipe; returns the state it was saved with.

    Raises:
        RunError: A file of it is missing, damaged, or of another recipe.
    """
    try:
        state = json.loads((path / "state.json").read_text())
        weights = torch.load(path / "weights.pt", weights_only=True)
        arrays = np.load(path / "arrays.npz", allow_pickle=False)
        model.set_parameters(weights["modules"])
        with torch.no_grad():
            model.log_ent_coef.copy_(weights["log_ent_coef"])
        _restore_buffer(model, arrays)
        scaling = model.get_vec_normalize_env().obs_rms
        scaling.mean, scaling.var, scaling.count = arrays["mean"], arrays["var"], float(arrays["count"])
        model.num_timesteps, model._n_updates, model._episode_num = state["steps"], state["updates"], state["episodes"]
    except Exception as error:  # whatever a damaged file makes its reader raise
        raise RunError(f"checkpoint '{path}' is damaged or of another recipe: {error}") from error
    return state


def _weights(model: SAC) -> dict[str, Any]:
    return {"modules": model.get_parameters(), "log_ent_coef": model.log_ent_coef.detach()}


def _buffer_arrays(model: SAC) -> dict[str, np.ndarray]:
    buffer = model.replay_buffer
    filled = buffer.buffer_size if buffer.full else buffer.pos
    return {"pos": np.int64(buffer.pos), **{name: getattr(buffer, name)[:filled] for name in _TRANSITION}}


def _scaling_arrays(model: SAC) -> dict[str, np.ndarray]:
    scaling = model.get_vec_normalize_env().obs_rms
    return {"mean": scaling.mean, "var": scaling.var, "count": np.float64(scaling.count)}


def _restore_buffer(model: SAC, arrays: Any) -> None:
    buffer = model.replay_buffer
    filled = len(arrays["rewards"])
    if filled > buffer.buffer_size:
        raise ValueError(f"{filled} transitions do not fit a buffer of {buffer.buffer_size}")
    for name in _TRANSITION:
        getattr(buffer, name)[:filled] = arrays[name]
    buffer.pos, buffer.full = int(arrays["pos"]), filled == buffer.buffer_size
    # The environments start anew: no return of several steps may reach from the old episodes into the new ones.
    buffer.timeouts[buffer.pos - 1] = True


def _to_disk(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a file system without fsync of folders
            raise
    finally:
        os.close(handle)
