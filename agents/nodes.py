"""Complete runs on the nodes of a Ray cluster, one per seed: ``python -m agents.nodes grasp --seeds
5 --out runs/sweep``."""

from __future__ import annotations

import platform
import sys
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from tempfile import gettempdir
from uuid import uuid4

from agents import RecipeError, RunError
from agents.collectors import connected, say
from agents.recipes import RECIPES, Recipe, add_recipe, recipe_of
from agents.runs import RUN, recipe_in, remove_run, saved_trials
from agents.train import train
from hpac_gym.command import command_parser, minutes, run, whole_number
from hpac_gym.errors import HpacError
from hpac_gym.output import writable_folder


def train_seed(recipe: Recipe, time_limit: float, name: str) -> dict[str, bytes]:
    """Train a complete run in this process, so that it ends with the process; returns the files of
    its folder by name.

    The folder has this name among the node's temporary files. It outlives a killed process, and a
    second call on the same node continues from its checkpoint.

    Raises:
        RunError: The training failed or was interrupted.
    """
    folder = Path(gettempdir()) / name
    folder.mkdir(exist_ok=True)
    try:
        if train(recipe, folder, time_limit=time_limit):
            raise RunError("the training was interrupted")
        files = {
            str(path.relative_to(folder)): path.read_bytes()
            for path in folder.rglob("*")
            if path.is_file()
        }
    except (HpacError, OSError) as error:
        raise RunError(
            f"{error}; '{folder}' on node '{platform.node()}' keeps what was saved"
        ) from error
    rmtree(folder)
    return files


def main(argv: list[str] | None = None) -> int:
    """Train complete runs on the nodes of a Ray cluster, one per seed; those that are in the folder
    already are kept.
    """
    parser = command_parser("agents.nodes", main.__doc__)
    parser.add_argument("recipe", help=f"one of {', '.join(sorted(RECIPES))}")
    parser.add_argument(
        "--seeds",
        type=whole_number(1),
        required=True,
        metavar="N",
        help="train with the seeds 0 to N - 1",
    )
    parser.add_argument(
        "--out", type=Path, required=True, help="folder, in which each run gets a folder seed-N"
    )
    parser.add_argument(
        "--time-limit",
        type=minutes,
        default=float("inf"),
        metavar="MINUTES",
        help="end each run after so long",
    )
    add_recipe(parser)
    args = parser.parse_args(argv)
    if hasattr(args, "seed"):
        raise RecipeError(
            f"--seed is {args.seed}: --seeds gives the runs the seeds 0 to {args.seeds - 1}"
        )
    recipe = recipe_of(args)
    writable_folder(args.out)
    wanted = {args.out / f"seed-{seed}": replace(recipe, seed=seed) for seed in range(args.seeds)}
    for folder in [folder for folder in wanted if (folder / RUN).exists()]:
        if recipe_in(folder) != wanted.pop(folder):
            raise RunError(
                f"folder '{folder}' holds a run with other settings: choose another --out, or remove it"
            )
        say(
            f"{folder} was done before, with {saved_trials(folder):,} of {recipe.episodes:,} trials"
        )
    ray = connected()
    # A process per run.
    task = ray.remote(num_cpus=1, scheduling_strategy="SPREAD", max_calls=1)(train_seed)
    run_id = uuid4().hex
    limit = 60 * args.time_limit
    running = {
        task.remote(recipe, limit, f"hpac-{run_id}-{folder.name}"): folder
        for folder, recipe in wanted.items()
    }
    failed = 0
    while running:
        (reference, *_), _ = ray.wait(list(running))
        folder = running.pop(reference)
        try:
            files = ray.get(reference)
        except ray.exceptions.RayError as error:
            failed += 1
            say(f"{folder} failed: {f'{error}'.strip().splitlines()[-1]}")
            continue
        remove_run(folder)
        for name, data in sorted(
            files.items(), key=lambda file: file[0] == RUN
        ):  # the settings last: they mark a complete run
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(data)
        say(f"{folder} is done")
    ray.shutdown()
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(run(main))
