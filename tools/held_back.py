"""Choose settings of the recipe grasp-any on training objects alone: ``python -m tools.held_back
--out runs/NAME``.

Trains on 160 of the 200 training objects and evaluates on the other 40, four whole families.
Further arguments are those of ``agents.train``. A folder that already holds a policy is only
evaluated."""

import sys
from pathlib import Path

from agents import POLICY, train
from agents.trials import training_task
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.envs import GraspAny
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import wilson_interval
from tools.any_player import Player
from tools.any_touch import by_policy

OF_EACH = 10
FAMILIES = (1, 6, 11, 16)
"""Objects of a family, and the families that are held back, in the order of the set."""
HELD_BACK = {
    f"train_{OF_EACH * family + number:03}" for family in FAMILIES for number in range(OF_EACH)
}
"""Names of the objects that are held back."""


def keep(task: GraspAny, back: bool) -> GraspAny:
    """The task, left with the training objects that are held back, or with all others."""
    drawn = task.setups
    drawn.objects = tuple(entry for entry in drawn.objects if (entry.name in HELD_BACK) == back)
    return task


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.held_back", __doc__)
    parser.add_argument(
        "--episodes", type=whole_number(1), default=1_500, help="episodes of each evaluation"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the training")
    args, settings = parser.parse_known_args(argv)
    if not (args.out / POLICY).exists():
        words = ["grasp-any", "--out", str(args.out), *settings]
        if status := train.main(words, make=lambda recipe: keep(training_task(recipe), back=False)):
            return status
    print("| objects | hands | success [%] |\n| --- | --- | --- |")
    for title, back, hands in (
        ("trained on", False, "nominal"),
        ("held back", True, "nominal"),
        ("held back", True, "train"),
    ):
        player = Player("train", min(64, args.episodes), hands)
        keep(player.task, back)

        def begin(seen, places, task=player.task):
            closing = by_policy(task, seen, args.out / POLICY)
            return lambda step, _: closing(step)

        won = player.play(range(HELD_OUT_SEED, HELD_OUT_SEED + args.episodes), begin)
        low, high = wilson_interval(int(won.sum()), len(won))
        print(
            f"| {title} | {hands} | {100 * won.mean():.1f} [{100 * low:.1f}, {100 * high:.1f}] |",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
