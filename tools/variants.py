"""Compare variants of the recipe *grasp* over seeds: ``python -m tools.variants conditions --out
runs/variants``.

``learner``: the recipe as it is; ``critics see deploy``, without the asymmetric critics; ``near
objects first``, a curriculum, in which the largest distance of the object grows over the first
third of the trials. ``conditions``: what the episodes of the training have. Every policy is
evaluated on held-out episodes, on the *twin*; with ``conditions`` elsewhere too. Median and lowest
are those on the *twin*, the other columns interquartile means, with their bootstrap interval. A
repeated call skips finished trainings, and begins an interrupted one again."""

import os
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from agents import POLICY, RunError
from agents.recipes import RECIPES, Recipe
from agents.reproduce import middle
from agents.runs import RUN, recipe_in, saved_trials
from agents.train import train
from agents.trials import training_task
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.evaluate import DEFAULT_ENV, evaluate
from hpac_gym.model import HPAC, Hand
from hpac_gym.output import markdown, writable_folder
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.task import Task

NEAR = 0.25
"""Share of the range of distances with which the curriculum begins."""
GROW = 0.4
"""Episodes drawn for each trial of the training until all distances occur: a third of the trials,
since a few are rejected.
"""


class NearFirst(Grasp):
    """Grasp with objects near the wrist first; the range of distances grows with each episode of a
    recipe's training.
    """

    def __init__(self, recipe: Recipe) -> None:
        super().__init__()
        self._all = self.config.beyond_wrist
        self._grow = GROW * recipe.episodes
        self._drawn = 0

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        low, high = self._all
        share = min(NEAR + (1.0 - NEAR) * self._drawn / self._grow, 1.0)
        self.config = replace(self.config, beyond_wrist=(low, low + share * (high - low)))
        self._drawn += 1
        return super().setup(rng, hand)


VARIANTS: dict[str, dict[str, dict[str, Any]]] = {
    "learner": {
        "as it is": {},
        "critics see deploy": {"critic_obs": "deploy"},
        "near objects first": {},
    },
    "conditions": {
        "as it is": {},
        "hands that differ": {"randomize": "hand"},
        "all that differs": {"randomize": "full"},
        "light fingers": {"set_ups": ("mujoco/light",)},
        "weak contacts": {"contacts": "weak"},
        "light fingers, weak contacts": {"set_ups": ("mujoco/light",), "contacts": "weak"},
        "PyBullet": {"set_ups": ("pybullet/twin",)},
    },
}
"""Settings of each variant of the recipe."""
JUDGED: dict[str, dict[str, dict[str, str]]] = {
    "learner": {"twin": {"engine": "mujoco"}},
    "conditions": {
        "twin": {"engine": "mujoco"},
        "twin, all differs": {"engine": "mujoco", "randomize": "full"},
        "light": {"engine": "mujoco", "body": "light"},
        "PyBullet": {"engine": "pybullet"},
    },
}
"""Options of the environments in which the policies are evaluated; the first is that of median and
lowest.
"""


def task_maker(name: str) -> Callable[[Recipe], Task]:
    """Maker of the task in which a variant is trained."""
    return NearFirst if name == "near objects first" else training_task


def success(
    policies: list[str], options: dict[str, str], episodes: int, workers: int
) -> np.ndarray:
    """Success of policies in the same episodes, shape (policies,)."""
    judged = evaluate(policies, DEFAULT_ENV, episodes, workers=workers, options=options).summary()[
        "policies"
    ]
    return np.array([cell["success_rate"] for cell in judged.values()])


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.variants", __doc__)
    parser.add_argument("what", choices=VARIANTS, help="what differs between the variants")
    parser.add_argument(
        "--seeds", type=whole_number(1), default=5, help="number of trainings of each variant"
    )
    parser.add_argument(
        "--trials", type=whole_number(3_000), default=8_000, help="trials per training"
    )
    parser.add_argument(
        "--episodes",
        type=whole_number(1),
        default=1_000,
        help="held-out episodes of each policy and cell",
    )
    parser.add_argument(
        "--workers",
        type=whole_number(1),
        default=os.cpu_count() or 1,
        help="processes of an evaluation",
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    args = parser.parse_args(argv)
    policies: dict[str, list[str]] = {}
    for seed, (name, settings) in product(range(args.seeds), VARIANTS[args.what].items()):
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
            if status := train(recipe, out, fresh=True, make=task_maker(name)):
                return status
    cells = JUDGED[args.what]
    print(markdown(("variant", "median [%]", "lowest", *cells), ()))
    for name, files in policies.items():
        rates = [success(files, options, args.episodes, args.workers) for options in cells.values()]
        texts = [
            f"{100 * np.median(rates[0]):.1f}",
            f"{100 * rates[0].min():.1f}",
            *map(middle, rates),
        ]
        print(f"| {name} | {' | '.join(texts)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
