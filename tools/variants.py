"""Compare variants of the recipe *grasp* over seeds: ``python -m tools.variants --out runs/variants``.

``as it is``; ``critics see deploy``: without the asymmetric critics; ``near objects first``: a curriculum, in which the largest
distance of the object grows over the first third of the trials. Every policy is evaluated on held-out episodes; a repeated call
skips finished trainings.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from agents import POLICY, command_parser
from agents.closures import training_task
from agents.evaluate import DEFAULT_TASK, evaluate
from agents.recipes import RECIPES, Recipe
from agents.reproduce import over_runs
from agents.train import train
from hpac import run, whole_number
from hpac_gym.model import HPAC, Hand
from hpac_gym.output import writable_folder
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.tasks.grasp import Grasp

NEAR = 0.25
"""Share of the range of distances with which the curriculum begins."""
GROW = 0.4
"""Episodes drawn for each trial of the training until all distances occur: a third of the trials, since a few are rejected."""


class NearFirst(Grasp):
    """Grasp with objects near the wrist first; the range of distances grows with each episode of a recipe's training."""

    def __init__(self, recipe: Recipe) -> None:
        super().__init__()
        self._all, self._grow, self._drawn = self.config.beyond_wrist, GROW * recipe.episodes, 0

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        low, high = self._all
        share = min(NEAR + (1.0 - NEAR) * self._drawn / self._grow, 1.0)
        self.config = replace(self.config, beyond_wrist=(low, low + share * (high - low)))
        self._drawn += 1
        return super().setup(rng, hand)


VARIANTS = {
    "as it is": ({}, training_task),
    "critics see deploy": ({"critic_obs": "deploy"}, training_task),
    "near objects first": ({}, NearFirst),
}
"""Settings and maker of the task of each variant."""


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.variants", __doc__)
    parser.add_argument("--seeds", type=whole_number(1), default=5, help="number of trainings of each variant")
    parser.add_argument("--trials", type=whole_number(3_000), default=12_000, help="trials per training")
    parser.add_argument("--episodes", type=whole_number(1), default=1_000, help="held-out episodes of each policy")
    parser.add_argument("--out", type=Path, required=True, help="folder of the trainings")
    args = parser.parse_args(argv)
    for name, (settings, make) in VARIANTS.items():
        cells = []
        for seed in range(args.seeds):
            out = args.out / f"{name.replace(' ', '-')}-{seed}"
            if not (out / POLICY).exists():
                writable_folder(out)
                # With one checkpoint only, a folder with a policy holds a complete training.
                recipe = replace(RECIPES["grasp"], seed=seed, episodes=args.trials, checkpoint_every=args.trials, **settings)
                if status := train(recipe, out, make=make):
                    return status
            judged = evaluate([str(out / POLICY)], DEFAULT_TASK, args.episodes, options={"engine": "mujoco"})
            cells += judged.summary()["policies"].values()
        print(f"{name}: {over_runs(cells)}", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
