"""Train a policy: ``python -m agents.train grasp --out runs/NAME``.

The folder gets ``policy.zip`` (the policy) and ``learning_curve.png``, both updated at every
checkpoint, ``progress.csv``, ``run.json`` (the settings) and the last checkpoint, from which
``--resume`` continues. With ``--trials-of`` there is no picture. After every checkpoint new
episodes begin, with random numbers of its own, so that a killed and resumed run ends with the same
policy as an uninterrupted one.

A checkpoint is a folder ``checkpoint-EPISODES`` that is renamed to this name once its contents are
on disk; only then is the previous one removed. It holds JSON and plain arrays: reading it executes
no foreign code."""

from __future__ import annotations

import errno
import json
import os
import shutil
import signal
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents import (
    POLICY,
    RecipeError,
    RunError,
    command_parser,
    minutes,
    other_versions,
    target_of,
    versions,
)
from agents.curves import CURVE, PAGE, PICTURE, RESULTS, Progress, drop_rows_after, report
from agents.recipes import (
    RECIPES,
    Recipe,
    add_recipe,
    given_settings,
    recipe_of,
    settings_of,
    with_settings,
)
from hpac import INTERRUPTED, run, whole_number
from hpac_gym.errors import HpacError
from hpac_gym.evaluation.seeds import training_seed
from hpac_gym.output import writable_folder, write_text
from hpac_gym.policies import PolicyFile, write_policy

if TYPE_CHECKING:
    from agents.closures import Learner
    from hpac_gym.tasks.task import Task

RUN = "run.json"
_PREFIX = "checkpoint-"
_UNFINISHED = ".unfinished"


def train(
    recipe: Recipe,
    out: Path,
    *,
    fresh: bool = False,
    time_limit: float = float("inf"),
    started: float | None = None,
    nodes: int = 0,
    make: Callable[[Recipe], Task] | None = None,
) -> int:
    """Train a recipe in the folder ``out``, from its checkpoint if it has one, and return the exit
    status.

    ``fresh`` replaces a run in the folder, which is kept until everything that the new one needs
    was found. ``time_limit`` [s] ends the training cleanly, counted from ``started`` on the
    monotonic clock. If ``nodes`` is positive, that many collectors of `agents.nodes` try the
    closures. ``make`` makes a task of the recipe for each of its set-ups; None is
    `agents.closures.training_task`.

    Raises:
        RunError: The training diverged, or its folder cannot be read or written.
    """
    # Imported here: loading PyTorch takes seconds, which a mistyped argument should not cost.
    import torch

    from agents.closures import Learner, training_task, worlds_of

    torch.set_num_threads(1)
    done = 0 if fresh else saved_trials(out)
    if nodes:
        from agents.nodes import Collectors

        all_worlds = [Collectors(recipe, nodes, done)]
    elif recipe.trials_of:
        from agents.recorded import Recorded

        all_worlds = [Recorded(recipe, done)]
    else:
        all_worlds = worlds_of(recipe, make or training_task)
    first = all_worlds[0]
    learner = Learner(recipe, first.observed, first.deployed, first.phases)
    state = {"seconds": 0.0, "env_steps": 0}
    if fresh:
        remove_run(out)
    elif checkpoint := latest_checkpoint(out):
        state |= load_checkpoint(checkpoint, learner, first.tried if recipe.trials_of else {})
    write_text(out / RUN, json.dumps(asdict(recipe), indent=2) + "\n")
    drop_rows_after(out / CURVE, done)
    target = target_of(recipe.env_id, engine=recipe.set_ups[0].partition("/")[0])
    spent = done, state["env_steps"], state["seconds"]
    progress = Progress(out, recipe.episodes, recipe.env_steps, *spent, time_limit, started)
    _stop_on_signal(progress)

    def begin_episodes() -> None:
        learner.reseed(training_seed(recipe.seed, learner.trials.count, 1))
        for worlds in all_worlds:
            worlds.start(training_seed(recipe.seed, learner.trials.count, recipe.num_envs))

    def save() -> None:
        save_checkpoint(
            out, learner, {"seconds": progress.seconds, "env_steps": progress.env_steps}
        )
        about = {
            **target,
            "algorithm": "closures",
            "closure": asdict(recipe.closures),
            "settings": asdict(recipe),
            "episodes": learner.trials.count,
            "env_steps": progress.env_steps,
            "seconds": round(progress.seconds, 1),
            "versions": versions(),
        }
        write_policy(out / POLICY, PolicyFile(learner.policy(), about))
        progress.write_row(learner.entropy)
        if (
            not recipe.trials_of and (out / CURVE).exists()
        ):  # the successes of others say nothing about this policy
            try:
                report(out)
            except HpacError as error:
                print(f"no picture: {error}", file=sys.stderr)

    begin_episodes()
    going = done < recipe.episodes
    saved = done
    while going:
        for worlds in all_worlds:
            trials = worlds.step(learner, partial(learner.learn, progress.share))
            learner.trials.add(*trials)
            going = progress.add(
                (trials[2] == worlds.phases).tolist(), worlds.steps, learner.entropy
            )
        going = going and progress.env_steps + recipe.num_envs <= recipe.env_steps
        if learner.trials.count >= saved + recipe.checkpoint_every:
            saved = learner.trials.count
            save()
            begin_episodes()
    progress.close()
    save()
    for worlds in all_worlds:
        worlds.close()
    print(
        f"{progress.stopped_by or 'done'} after {learner.trials.count:,} trials: {out / POLICY}",
        file=sys.stderr,
    )
    return INTERRUPTED if progress.stopped_by == "interrupted" else 0


def save_checkpoint(folder: Path, learner: Learner, state: dict[str, Any]) -> Path:
    """Write a checkpoint of the learner, its optimisers, its trials and the scaling; returns its
    folder.

    Raises:
        RunError: The training has diverged, the disk is full or the folder cannot be written; the
            previous checkpoint is kept.
    """
    final = folder / f"{_PREFIX}{learner.trials.count:09d}"
    unfinished = final.with_suffix(_UNFINISHED)
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
        shutil.rmtree(final, ignore_errors=True)
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
    found = [
        path for path in folder.glob(f"{_PREFIX}*") if path.name.removeprefix(_PREFIX).isdecimal()
    ]
    return max(found, default=None)


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


def load_checkpoint(path: Path, learner: Learner, trials: dict[str, np.ndarray]) -> dict[str, Any]:
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
        if len(arrays["survived"]) != state["episodes"]:
            raise ValueError(f"{len(arrays['survived'])} trials, not {state['episodes']}")
        if others := other_versions(state["versions"]):
            raise ValueError(f"it was written with {others}")
        if not min(state.get(name, 0) for name in ("updates", "seconds", "env_steps")) >= 0:
            raise ValueError("its updates, seconds or env_steps are negative")
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


def main(argv: list[str] | None = None, make: Callable[[Recipe], Task] | None = None) -> int:
    """The command; ``make`` is as in `train`."""
    started = time.monotonic()
    parser = command_parser("agents.train", __doc__)
    parser.add_argument(
        "recipe", nargs="?", help=f"one of {', '.join(sorted(RECIPES))}; needed unless --resume"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument(
        "--time-limit",
        type=minutes,
        default=float("inf"),
        metavar="MINUTES",
        help="end cleanly after this time",
    )
    parser.add_argument(
        "--resume",
        action="store_true",
        help="continue the run in the folder; only --episodes can change",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace a run that is already in the folder"
    )
    parser.add_argument(
        "--trials-of",
        nargs="+",
        metavar="RUN",
        help="learn from the trials in these folders, without physics",
    )
    parser.add_argument(
        "--nodes",
        type=whole_number(0),
        default=0,
        metavar="N",
        help="number of collectors on a Ray cluster",
    )
    add_recipe(parser)
    args = parser.parse_args(argv)
    recipe = _resumed_recipe(args) if args.resume else _fresh_recipe(args)
    limits = {"time_limit": 60 * args.time_limit, "started": started}
    return train(recipe, args.out, fresh=not args.resume, nodes=args.nodes, make=make, **limits)


def _fresh_recipe(args: Namespace) -> Recipe:
    """The recipe of a new run."""
    if args.recipe is None:
        raise RecipeError(f"no recipe given: it must be one of {', '.join(sorted(RECIPES))}")
    recipe = recipe_of(args)
    if any((args.out / name).exists() for name in (RUN, POLICY)) and not args.overwrite:
        raise RunError(
            f"folder '{args.out}' already holds a run: --resume continues it, --overwrite replaces it"
        )
    if args.trials_of:
        recipe = _with_trials(recipe, args)
    writable_folder(args.out)
    return recipe


def remove_run(folder: Path) -> None:
    """Remove what a run left in a folder.

    Raises:
        RunError: A checkpoint cannot be removed.
    """
    for name in (RUN, POLICY, CURVE, PICTURE, RESULTS, PAGE):
        (folder / name).unlink(missing_ok=True)
    for old in folder.glob(f"{_PREFIX}*"):
        shutil.rmtree(old, ignore_errors=True)
    if kept := latest_checkpoint(folder):
        raise RunError(f"cannot remove checkpoint '{kept}' of the run before")


def _with_trials(recipe: Recipe, args: Namespace) -> Recipe:
    """The recipe with the trials of other runs: all of them, unless fewer episodes are asked
    for.
    """
    folders = [Path(folder) for folder in args.trials_of]
    if args.nodes:
        raise RecipeError("--trials-of needs no physics, so it does not go with --nodes")
    if args.out.resolve() in [folder.resolve() for folder in folders]:
        raise RecipeError(
            f"--out is '{args.out}', whose trials it should learn from: it must be another folder"
        )
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise RecipeError(f"--trials-of is {' '.join(args.trials_of)}: it names a run twice")
    if empty := next((folder for folder in folders if not saved_trials(folder)), None):
        raise RunError(f"no trials in '{empty}': it holds no checkpoint")
    limits = {"episodes": sum(map(saved_trials, folders)), "env_steps": Recipe().env_steps}
    limits = {name: limit for name, limit in limits.items() if not hasattr(args, name)}
    return replace(recipe, trials_of=tuple(args.trials_of), **limits)


def _resumed_recipe(args: Namespace) -> Recipe:
    given = given_settings(args, Recipe)
    if args.recipe is not None or args.overwrite or args.trials_of or set(given) - {"episodes"}:
        raise RecipeError("a resumed run keeps its settings: only --episodes can change")
    recipe = with_settings(recipe_in(args.out), given)
    if args.nodes and recipe.trials_of:
        raise RecipeError(
            f"--nodes is {args.nodes}: the run in '{args.out}' learns from recorded trials, without physics"
        )
    if (saved := saved_trials(args.out)) > recipe.episodes:
        raise RecipeError(f"episodes is {recipe.episodes:,}: the run has {saved:,} trials already")
    writable_folder(args.out)
    return recipe


def _stop_on_signal(progress: Progress) -> None:
    """End the training with a checkpoint at the first Ctrl-C or SIGTERM, and immediately at the
    second.
    """

    def stop(number: int, frame: Any) -> None:
        progress.stopped_by = "interrupted"
        signal.signal(number, signal.SIG_DFL)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)


if __name__ == "__main__":
    sys.exit(run(main))
