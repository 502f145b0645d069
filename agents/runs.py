"""The folder of a run: its settings and its checkpoints.

A checkpoint is a folder ``checkpoint-EPISODES`` that is renamed to this name once its contents are
on disk; only then is the previous one removed. It holds JSON and plain arrays: reading it executes
no foreign code."""

from __future__ import annotations

import errno
import json
import math
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents import POLICY, RunError
from agents.curves import PAGE, PICTURE, RESULTS
from agents.progress import BOARD, CURVE
from agents.recipes import Recipe, settings_of
from hpac_gym.evaluation.environment import versions

if TYPE_CHECKING:
    from agents.learner import Learner

RUN = "run.json"
_PREFIX = "checkpoint-"
_COUNTED = {"updates": int, "env_steps": int, "seconds": int | float}
"""Numbers of a checkpoint with which a resumed run goes on."""


def other_versions(told: Mapping[str, str]) -> str:
    """The entries of `told` that differ from `versions` here, in words; empty if there are none."""
    here = versions()
    return ", ".join(
        f"{name} {told.get(name)}, not {here[name]} as here"
        for name in here
        if told.get(name) != here[name]
    )


def save_checkpoint(folder: Path, learner: Learner, state: dict[str, Any]) -> Path:
    """Write a checkpoint of the learner, its optimisers, its trials and the scaling, unless there is
    one of as many trials; returns its folder.

    Raises:
        RunError: The training has diverged, the disk is full or the folder cannot be written; the
            previous checkpoint is kept.
    """
    final = folder / f"{_PREFIX}{learner.trials.count:09d}"
    if final.exists():
        return final
    unfinished = final.with_suffix(".unfinished")
    arrays = learner.arrays()
    try:
        if bad := next(
            (name for name, array in arrays.items() if not np.isfinite(array).all()), None
        ):
            raise ValueError(f"the training has diverged, {bad} is not finite")
        shutil.rmtree(unfinished, ignore_errors=True)
        unfinished.mkdir(parents=True)
        np.savez(unfinished / "arrays.npz", **arrays)
        state = {
            "episodes": learner.trials.count,
            "updates": learner.updates,
            "versions": versions(),
            **state,
        }
        (unfinished / "state.json").write_text(json.dumps(state, indent=2) + "\n")
        for path in (*unfinished.iterdir(), unfinished):
            _to_disk(path)
        os.rename(unfinished, final)
        _to_disk(folder)
    except (OSError, ValueError) as error:
        shutil.rmtree(unfinished, ignore_errors=True)
        kept = latest_checkpoint(folder)
        reason = getattr(error, "strerror", None) or error
        which = f"'{kept.name}' is kept" if kept else "there is no earlier one"
        raise RunError(f"cannot write checkpoint '{final}': {reason}; {which}") from error
    for old in folder.glob(f"{_PREFIX}*"):
        if old != final:
            shutil.rmtree(old, ignore_errors=True)
    return final


def latest_checkpoint(folder: Path) -> Path | None:
    """The latest complete checkpoint in a folder; None without one."""
    complete = [
        path for path in folder.glob(f"{_PREFIX}*") if path.name.removeprefix(_PREFIX).isdecimal()
    ]
    return max(complete, default=None)


def saved_trials(folder: Path) -> int:
    """Number of trials in the latest complete checkpoint in a folder; 0 without one."""
    path = latest_checkpoint(folder)
    return int(path.name.removeprefix(_PREFIX)) if path else 0


def recipe_in(folder: Path) -> Recipe:
    """The recipe of the run in a folder.

    Raises:
        RunError: The folder holds no run, or a damaged one, or one of another version.
    """
    try:
        return settings_of(json.loads((folder / RUN).read_text()))
    except FileNotFoundError:
        raise RunError(f"no run in '{folder}': it has no {RUN}") from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RunError(f"cannot read the settings of '{folder / RUN}': {error}") from None


def load_checkpoint(
    path: Path, learner: Learner, trials: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Load a checkpoint, and the columns of trials that it leaves out, into a learner of the same
    recipe; returns its state.

    Raises:
        RunError: A file is missing or damaged, or the checkpoint is of another recipe or of other
            versions.
    """
    try:
        state = json.loads((path / "state.json").read_text())
        with np.load(path / "arrays.npz", allow_pickle=False) as file:
            arrays = dict(file) | trials
        if others := other_versions(state["versions"]):
            raise ValueError(f"it was written with {others}")
        for name, kind in _COUNTED.items():
            value = state.get(name, 0)  # older checkpoints lack some
            if not (isinstance(value, kind) and 0 <= value < math.inf):
                raise ValueError(f"{name} is {value!r}")
        learner.restore(arrays, state["updates"])
    except Exception as error:  # a damaged file can make its reader raise anything
        raise RunError(
            f"checkpoint '{path}' is damaged, of another recipe or of other versions: {error}"
        ) from error
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


def parts_of_run(folder: Path) -> list[Path]:
    """What a run has left in a folder."""
    named = (folder / name for name in (RUN, POLICY, CURVE, PICTURE, RESULTS, PAGE, BOARD))
    return [*filter(Path.exists, named), *folder.glob(f"{_PREFIX}*")]


def remove_run(folder: Path) -> None:
    """Remove what a run left in a folder.

    Raises:
        RunError: A checkpoint cannot be removed.
    """
    for part in parts_of_run(folder):
        if part.is_dir():
            shutil.rmtree(part, ignore_errors=True)
        else:
            part.unlink(missing_ok=True)
    if kept := latest_checkpoint(folder):
        raise RunError(f"cannot remove checkpoint '{kept}' of the run before")


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Keep a folder for one training, also beside other processes.

    Raises:
        RunError: Another training is writing to it, or it cannot be written.
    """
    from filelock import FileLock, Timeout  # of PyTorch's own requirements

    lock = FileLock(folder / ".lock", blocking=False)
    try:
        lock.acquire()
    except Timeout:
        raise RunError(f"another training is writing to folder '{folder}'") from None
    except OSError as error:
        raise RunError(f"cannot lock folder '{folder}': {error.strerror or error}") from error
    try:
        yield
    finally:
        lock.release()
