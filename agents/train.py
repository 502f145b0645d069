"""Train a policy: ``python -m agents.train grasp --out runs/NAME``.

The folder gets ``policy.hpac`` (the policy) and ``learning_curve.png``, both updated at every
checkpoint, ``progress.csv``, ``tensorboard`` (losses, calibration, entropy), ``run.json`` (the
settings) and the last checkpoint, from which
``--resume`` continues. With ``--trials-of`` there is no picture. After every checkpoint new
episodes begin, with random numbers of its own, so that a killed and resumed run ends with the same
policy as an uninterrupted one."""

import json
import signal
import sys
from argparse import Namespace
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

from agents import POLICY, RecipeError, RunError, target_of
from agents.curves import PICTURE, draw, read_curve
from agents.progress import CURVE, Progress, drop_rows_after
from agents.recipes import (
    RECIPES,
    Recipe,
    add_recipe,
    given_settings,
    recipe_of,
    with_settings,
)
from agents.recorded import Recorded
from agents.runs import (
    RUN,
    alone_in,
    latest_checkpoint,
    load_checkpoint,
    parts_of_run,
    recipe_in,
    remove_run,
    save_checkpoint,
    saved_trials,
)
from agents.trials import training_task, worlds_of
from hpac_gym.command import INTERRUPTED, command_parser, minutes, run, whole_number
from hpac_gym.errors import HpacError
from hpac_gym.evaluation.environment import versions
from hpac_gym.evaluation.options import env_options
from hpac_gym.evaluation.seeds import training_seed
from hpac_gym.output import writable_folder, write_text
from hpac_gym.policies import PolicyFile, write_policy


def train(
    recipe: Recipe,
    out: Path,
    *,
    fresh: bool = False,
    time_limit: float = float("inf"),
    nodes: int = 0,
) -> int:
    """Train a recipe in the folder ``out``, from its checkpoint if it has one, and return the exit
    status.

    ``fresh`` replaces a run in the folder, which is kept until everything that the new one needs
    was found. ``time_limit`` [s] ends the training cleanly. If ``nodes`` is positive, that many
    collectors of `agents.collectors` try the closures.

    Raises:
        RunError: The training diverged, or its folder cannot be read or written.
    """
    # Imported here: loading PyTorch takes seconds, which a mistyped argument should not cost.
    import torch

    from agents.learner import Learner

    torch.set_num_threads(1)
    done = 0 if fresh else saved_trials(out)
    if nodes:
        from agents.collectors import Collectors

        sources = [Collectors(recipe, nodes, done)]
    elif recipe.trials_of:
        sources = [Recorded(recipe, done)]
    else:
        sources = worlds_of(recipe)
    first = sources[0]
    learner = Learner(recipe, first.observed, first.deployed, first.phases)
    state = {"seconds": 0.0, "env_steps": 0}
    if fresh:
        remove_run(out)
    elif checkpoint := latest_checkpoint(out):
        state |= load_checkpoint(checkpoint, learner, first.tried)
        begun = state.get("hashes", first.hashes)  # older checkpoints have none
        for folder, told in first.hashes.items():
            if begun.get(folder) != told:
                words = f"'{folder}' no longer has the trials that the run in '{out}' began with"
                raise RunError(words)
    write_text(out / RUN, json.dumps(asdict(recipe), indent=2) + "\n")
    drop_rows_after(out / CURVE, done)
    target = target_of(recipe.env_id, **recipe.options, engine=recipe.set_ups[0].partition("/")[0])
    spent = done, state["env_steps"], state["seconds"]
    progress = Progress(out, recipe.episodes, recipe.env_steps, *spent, time_limit)
    before = _stop_on_signal(progress)

    def begin_episodes() -> None:
        learner.reseed(training_seed(recipe.seed, learner.trials.count, 1))
        for source in sources:
            source.start(training_seed(recipe.seed, learner.trials.count, recipe.num_envs))

    def save() -> None:
        now = {"seconds": progress.seconds, "env_steps": progress.env_steps}
        save_checkpoint(out, learner, now | {"hashes": dict(first.hashes)})
        about = {
            **target,
            "algorithm": "one-step SAC",
            "closure": asdict(recipe.closures),
            "settings": asdict(recipe),
            "episodes": learner.trials.count,
            "env_steps": progress.env_steps,
            "seconds": round(progress.seconds, 1),
            "versions": versions(),
        }
        write_policy(out / POLICY, PolicyFile(learner.networks.policy(), about))
        progress.write_row(learner.metrics())
        # The successes of others say nothing about this policy, nor do results of an earlier one.
        if not recipe.trials_of and (out / CURVE).exists():
            try:
                draw(out / PICTURE, read_curve(out / CURVE), None)
            except HpacError as error:
                print(f"no picture: {error}", file=sys.stderr)

    begin_episodes()
    saved = done
    while progress.going and progress.env_steps + recipe.num_envs <= recipe.env_steps:
        for source in sources:
            trials = source.step(learner, partial(learner.learn, progress.share))
            if progress.env_steps + source.steps > recipe.env_steps:  # a chunk that is too long
                progress.stopped_by = "limit of steps"
                break
            learner.add(*trials)
            held = (trials[2] == source.phases).tolist()
            progress.add(held, source.steps, learner.metrics)
        if learner.trials.count >= saved + recipe.checkpoint_every:
            saved = learner.trials.count
            save()
            begin_episodes()
    save()
    for closed in (progress, *sources):
        closed.close()
    print(
        f"{progress.stopped_by or 'done'} after {learner.trials.count:,} trials: {out / POLICY}",
        file=sys.stderr,
    )
    if not learner.updates:
        print(
            f"it has learned nothing yet: updates begin after {recipe.random_episodes:,} trials",
            file=sys.stderr,
        )
    for number, handler in before.items():
        signal.signal(number, handler)
    return INTERRUPTED if progress.stopped_by == "interrupted" else 0


def main(argv: list[str] | None = None) -> int:
    args = parsed(argv)
    recipe = _resumed_recipe(args) if args.resume else _fresh_recipe(args)
    limit = 60 * args.time_limit
    with alone_in(args.out):
        return train(recipe, args.out, fresh=not args.resume, time_limit=limit, nodes=args.nodes)


def parsed(argv: list[str] | None = None) -> Namespace:
    """The arguments of the command."""
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
        help="end cleanly after this time; a new run explores less towards it, a resumed one by its trials and steps alone",
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
    return parser.parse_args(argv)


def _fresh_recipe(args: Namespace) -> Recipe:
    """The recipe of a new run."""
    if args.recipe is None:
        raise RecipeError(f"no recipe given: it must be one of {', '.join(sorted(RECIPES))}")
    recipe = recipe_of(args)
    if (parts := parts_of_run(args.out)) and not args.overwrite:
        raise RunError(
            f"folder '{args.out}' already holds a run, '{parts[0].name}': --resume continues it, --overwrite replaces it"
        )
    if args.trials_of:
        recipe = _with_trials(recipe, args)
    training_task(recipe)  # errors are raised here, before anything is written
    writable_folder(args.out)
    return recipe


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
    given = given_settings(args)
    if (
        args.recipe is not None
        or args.overwrite
        or args.trials_of
        or args.env
        or env_options(args, args.env or "")
        or set(given) - {"episodes"}
    ):
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


def _stop_on_signal(progress: Progress) -> dict[int, Any]:
    """End the training with a checkpoint at the first Ctrl-C or SIGTERM, and immediately at the
    second. Returns the handlers that were there, by signal.
    """

    def stop(number: int, frame: Any) -> None:
        progress.stopped_by = "interrupted"
        signal.signal(number, signal.SIG_DFL)

    return {number: signal.signal(number, stop) for number in (signal.SIGINT, signal.SIGTERM)}


if __name__ == "__main__":
    sys.exit(run(main))
