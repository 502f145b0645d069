"""Compare conditions of training with the recipe *grasp* over seeds: ``python -m tools.variants
--out runs/variants``.

Every policy is evaluated on held-out episodes, on the *twin* and elsewhere. Median and lowest are
those on the *twin*, the other columns interquartile means, with their bootstrap interval. A
repeated call skips finished trainings, and begins an interrupted one again."""

import os
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from agents import POLICY, RunError
from agents.recipes import RECIPES
from agents.reproduce import middle
from agents.runs import RUN, recipe_in, saved_trials
from agents.train import train
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.evaluation.options import DEFAULT_ENV
from hpac_gym.output import markdown, writable_folder

VARIANTS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "hands that differ": {"randomize": "hand"},
    "all that differs": {"randomize": "full"},
    "light fingers": {"set_ups": ("mujoco/light",)},
    "weak contacts": {"contacts": "weak"},
    "light fingers, weak contacts": {"set_ups": ("mujoco/light",), "contacts": "weak"},
    "PyBullet": {"set_ups": ("pybullet/twin",)},
}
"""Settings of each variant of the recipe."""
JUDGED: dict[str, dict[str, str]] = {
    "twin": {"engine": "mujoco"},
    "twin, all differs": {"engine": "mujoco", "randomize": "full"},
    "light": {"engine": "mujoco", "body": "light"},
    "PyBullet": {"engine": "pybullet"},
}
"""Options of the environments in which the policies are evaluated; the first is that of median and
lowest.
"""


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.variants", __doc__)
    add_counts(
        parser,
        seeds=(1, 5, "number of trainings of each variant"),
        trials=(3_000, 8_000, "trials per training"),
        episodes=(1, 1_000, "held-out episodes of each policy and cell"),
        workers=(1, os.cpu_count() or 1, "processes of an evaluation"),
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    args = parser.parse_args(argv)
    policies: dict[str, list[str]] = {}
    for seed, (name, settings) in product(range(args.seeds), VARIANTS.items()):
        out = args.out / f"{name.replace(', ', ' ').replace(' ', '-')}-{seed}"
        policies.setdefault(name, []).append(str(out / POLICY))
        recipe = replace(
            RECIPES["grasp"],
            seed=seed,
            episodes=args.trials,
            checkpoint_every=args.trials,
            **settings,
        )
        if (out / RUN).exists() and recipe_in(out) != recipe:
            raise RunError(
                f"'{out}' holds a training with other settings than '{name}' with {args.trials} trials"
            )
        if saved_trials(out) < args.trials:
            writable_folder(out)
            if status := train(recipe, out, fresh=True):
                return status
    print(markdown(("variant", "median [%]", "lowest", *JUDGED), ()))
    for name, files in policies.items():
        rates = []
        for options in JUDGED.values():
            judged = evaluate(
                files, DEFAULT_ENV, args.episodes, workers=args.workers, options=options
            )
            cells = judged.summary()["policies"].values()
            rates.append(np.array([cell["success_rate"] for cell in cells]))
        ends = f"{100 * np.median(rates[0]):.1f} | {100 * rates[0].min():.1f}"
        print(f"| {name} | {ends} | {' | '.join(map(middle, rates))} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
