"""Train a policy: ``python -m agents.train --recipe grasp-sac --out runs/NAME``.

The folder gets ``policy.zip`` (the policy, anew at every checkpoint), ``progress.csv`` (the learning curve),
``tensorboard/``, ``run.json`` (the settings) and the last checkpoint, from which ``--resume`` goes on.
"""

import argparse
import json
import shutil
import signal
import sys
import time
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

from agents.command import command_parser, minutes
from agents.errors import RecipeError, RunError
from agents.learning_curve import CURVE, drop_rows_after
from agents.recipes import RECIPES, Recipe, recipe_named, with_settings
from agents.seeds import training_seed
from agents.tasks import make_task
from hpac import INTERRUPTED, run, whole_number
from hpac_gym.output import writable_folder, write_text
from hpac_gym.policies import PolicyFile, write_policy

POLICY = "policy.zip"
RUN = "run.json"


def main(argv: list[str] | None = None) -> int:
    started = time.monotonic()
    args = _parser().parse_args(argv)
    recipe = _resumed_recipe(args) if args.resume else _fresh_recipe(args)
    return train(recipe, args.out, resume=args.resume, time_limit=60 * args.time_limit, started=started)


def train(
    recipe: Recipe, out: Path, *, resume: bool = False, time_limit: float = float("inf"), started: float | None = None
) -> int:
    """Train by a recipe into the folder ``out``; returns the exit status.

    ``time_limit`` [s] ends the training cleanly, counted from ``started`` on the monotonic clock.
    """
    # Here and not above: loading PyTorch takes seconds, which a mistyped argument should not cost.
    from stable_baselines3.common.logger import configure

    from agents.checkpoints import latest_checkpoint, load_checkpoint, save_checkpoint
    from agents.learner import actor_of, make_learner, training_env, versions
    from agents.progress import Progress

    env = training_env(recipe)
    try:
        model = make_learner(recipe, env)
        checkpoint = latest_checkpoint(out) if resume else None
        state = load_checkpoint(checkpoint, model) if checkpoint else {"seconds": 0.0}
        if resume:
            drop_rows_after(out / CURVE, model.num_timesteps)
        if model.num_timesteps:
            model.set_random_seed(training_seed(recipe.seed, model.num_timesteps, recipe.n_envs))
        env.seed(training_seed(recipe.seed, model.num_timesteps, recipe.n_envs))
        model.set_logger(configure(str(out / "tensorboard"), ["tensorboard"]))

        def save(seconds: float) -> None:
            about = {
                "env_id": recipe.env_id,
                "algorithm": "SAC",
                "action_repeat": recipe.action_repeat,
                "settings": asdict(recipe),
                "steps": model.num_timesteps,
                "seconds": round(seconds, 1),
                "versions": versions(),
            }
            save_checkpoint(out, model, {"seconds": seconds})
            write_policy(out / POLICY, PolicyFile(actor_of(model), about))

        progress = Progress(out, recipe.steps, save, recipe.checkpoint_every, state["seconds"], time_limit, started)
        _stop_on_signal(progress)
        if model.num_timesteps < recipe.steps:
            model.learn(recipe.steps - model.num_timesteps, progress, log_interval=50, reset_num_timesteps=False)
        save(progress.seconds)
    finally:
        env.close()
    print(f"{progress.stopped_by or 'done'} after {model.num_timesteps:,} steps: {out / POLICY}", file=sys.stderr)
    return INTERRUPTED if progress.stopped_by == "interrupted" else 0


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("agents.train", __doc__)
    parser.add_argument("--recipe", help=f"one of {', '.join(sorted(RECIPES))}; needed unless --resume")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--seed", type=whole_number(0), help="seed of the run")
    parser.add_argument("--steps", type=whole_number(1), help="decisions in all")
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="change a setting of the recipe")
    parser.add_argument("--time-limit", type=minutes, default=float("inf"), metavar="MINUTES", help="end cleanly after so long")
    parser.add_argument("--resume", action="store_true", help="go on with the run in the folder")
    parser.add_argument("--overwrite", action="store_true", help="start again where the folder already holds a run")
    return parser


def _fresh_recipe(args: Any) -> Recipe:
    if args.recipe is None:
        raise RecipeError(f"which recipe? --recipe is one of {', '.join(sorted(RECIPES))}")
    named = [f"{name}={value}" for name in ("seed", "steps") if (value := getattr(args, name)) is not None]
    recipe = with_settings(recipe_named(args.recipe), [*args.set, *named])
    if (args.out / RUN).exists() and not args.overwrite:
        raise RunError(f"folder '{args.out}' already holds a run: --resume goes on with it, --overwrite starts again")
    make_task(recipe.env_id).close()  # before the folder is touched, and not in a worker
    writable_folder(args.out)
    for old in (args.out / RUN, args.out / POLICY, args.out / CURVE):
        old.unlink(missing_ok=True)
    for old in (*args.out.glob("checkpoint-*"), args.out / "tensorboard"):
        shutil.rmtree(old, ignore_errors=True)
    _write_run(args.out, recipe)
    return recipe


def _resumed_recipe(args: Any) -> Recipe:
    if args.recipe is not None or args.set or args.seed is not None or args.overwrite:
        raise RecipeError("a run goes on with the settings that it began with: with --resume only --steps can change")
    path = args.out / RUN
    try:
        settings = json.loads(path.read_text())
        settings = {name: tuple(value) if isinstance(value, list) else value for name, value in settings.items()}
        recipe = Recipe(**{field.name: settings[field.name] for field in fields(Recipe)})
    except FileNotFoundError:
        raise RunError(f"no run to go on with in '{args.out}': it has no {RUN}") from None
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise RunError(f"cannot go on with '{path}': {error}") from None
    writable_folder(args.out)
    if args.steps is not None:
        recipe = replace(recipe, steps=args.steps)
        _write_run(args.out, recipe)
    return recipe


def _write_run(out: Path, recipe: Recipe) -> None:
    write_text(out / RUN, json.dumps(asdict(recipe), indent=2) + "\n")


def _stop_on_signal(progress: Any) -> None:
    """The first Ctrl-C or SIGTERM ends the training with a checkpoint; a second one ends it at once."""

    def stop(number: int, frame: Any) -> None:
        progress.stop("interrupted")
        signal.signal(number, signal.SIG_DFL)

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)


if __name__ == "__main__":
    sys.exit(run(main))
