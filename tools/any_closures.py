"""Headroom of HPAC-GraspAny-v1: ``python -m tools.any_closures script``, ``ceiling`` or ``touch``.

``script`` searches better closures for the script, on training objects. ``ceiling`` counts the
episodes of a split that at least one closure holds. ``touch`` learns from each observation of a
closed hand whether to close again, with and without memory of the closing, and compares the
observations. All on MuJoCo, with nominal hands unless ``touch`` gets ``--varied-hands``; an episode
ends after the shake, which decides its success."""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.object_sets import SPLITS
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation.seeds import BENCHMARK_SEED
from hpac_gym.evaluation.statistics import paired_difference
from hpac_gym.policies import Closures
from hpac_gym.tasks.scripted import ANY_CLOSURES, AnyClosure, ScriptedGraspAny
from tools.any_player import Act, Player, rate
from tools.any_touch import FIRST, touch

# The ceiling
# -----------------------------------------------------------------------------------------------------------

LOWEST = np.array([-0.5, 0.2, 0.2, 0.2, 0.2, -0.25, 10.0, -6.0])
HIGHEST = np.array([0.8, 1.0, 1.0, 1.0, 1.0, 0.8, 28.0, 12.0])
"""Bounds of random closures: actions of the six goals, duration and thumb delay [control steps]."""
CLOSURES = Closures(goal=(-1.0, 1.0), duration=(10.0, 28.0), thumb_delay=(-6.0, 12.0))
TRIES = (1, 4, 16, 64)


def drawn_closure(seed: int, number: int) -> NDArray[np.float64]:
    """Decision of the random closure of a seed and trial number, shape (8,), −1…1."""
    return CLOSURES.decisions(np.random.default_rng([seed, number, 3]).uniform(LOWEST, HIGHEST))


def first_winners(player: Player, seeds: Sequence[int], most: int) -> dict[int, int]:
    """Number of random closures up to the first success, at most ``most``, by seed; seeds without
    success are absent.
    """
    tried = dict.fromkeys(seeds, 0)
    tries_of = {}
    while left := [seed for seed in seeds if seed not in tries_of and tried[seed] < most]:
        each = -(-player.count // len(left))  # keeps all worlds busy
        jobs = [
            (seed, number)
            for seed in left
            for number in range(tried[seed], min(tried[seed] + each, most))
        ]
        decisions = np.array([drawn_closure(*job) for job in jobs])
        won = player.play([seed for seed, _ in jobs], partial(_closing, decisions))
        for (seed, number), held in zip(jobs, won, strict=True):
            tried[seed] = number + 1
            if held:
                tries_of[seed] = min(number + 1, tries_of.get(seed, most))
    return tries_of


def _closing(decisions: NDArray, first: NDArray, places: NDArray) -> Act:
    chosen = decisions[places]
    return lambda step, seen: CLOSURES.actions(chosen, np.full(len(seen), step)).astype(np.float32)


def ceiling(objects: str, seeds: range) -> Iterator[str]:
    """Success rates of the best of several random closures, as lines."""
    tries_of = first_winners(Player(objects), seeds, TRIES[-1])
    for most in TRIES:
        yield f"{objects}, best of {most} random closures: {rate(sum(n <= most for n in tries_of.values()), len(seeds))}"


# The script
# ------------------------------------------------------------------------------------------------------------

SPREAD = np.array([0.12, 0.12, 0.12, 0.12, 0.20])
"""Initial standard deviations of the search around a kind's closure, in the order of `AnyClosure`'s
numbers.
"""
BOUNDS = np.array([[0.3, 0.1, 0.6, -0.5, 0.4], [1.57, 1.2, 1.3, 0.6, 1.6]])
ROUNDS = 6
EPISODES = 256
JUDGED_FROM = 500_000
"""Number of rounds, training episodes per round, and first training seed of the evaluation."""

Kind = tuple[bool, int]


def play_script(
    player: Player, seeds: Sequence[int], closure: Callable[[Kind], AnyClosure]
) -> tuple[list, NDArray]:
    """Run the script; returns kind and closure of each episode, and the successes."""
    kinds = []
    used = []

    def begin(first: NDArray, places: NDArray) -> Act:
        seen = [ScriptedGraspAny(player.task.terms).kind(row) for row in first]
        chosen = [closure(kind) for kind in seen]
        kinds.extend(seen), used.extend(chosen)
        scripts = [
            ScriptedGraspAny(player.task.terms, closures={kind: one})
            for kind, one in zip(seen, chosen, strict=True)
        ]
        for script in scripts:
            script.reset()
        return lambda step, rows: np.array(
            [script.act(row) for script, row in zip(scripts, rows, strict=True)]
        )

    won = player.play(seeds, begin)
    return list(zip(kinds, used, strict=True))[: len(seeds)], won


def script() -> Iterator[str]:
    """Search better closures of the kinds, moving each towards its successes; then compare both on
    the same episodes.
    """
    player = Player("train")
    rng = np.random.default_rng(5)
    seed = 10_000
    means = {kind: np.array(astuple(closure)) for kind, closure in ANY_CLOSURES.items()}
    for number in range(ROUNDS):
        spread = SPREAD * 0.88**number
        tried, won = play_script(
            player,
            range(seed, seed + EPISODES),
            lambda kind, spread=spread: AnyClosure(
                *np.clip(means[kind] + spread * rng.standard_normal(5), *BOUNDS)
            ),
        )
        seed += EPISODES
        for kind in means:
            mine = np.array([entry[0] == kind for entry in tried])
            if (mine & won).sum() >= 8:
                values = np.array([astuple(entry[1]) for entry in tried])
                means[kind] = np.clip(
                    means[kind] + 1.5 * (values[mine & won].mean(0) - values[mine].mean(0)), *BOUNDS
                )
        yield f"round {number + 1}: {rate(int(won.sum()), EPISODES)}"
    fitted = {kind: AnyClosure(*mean.round(2).tolist()) for kind, mean in means.items()}
    judged = range(JUDGED_FROM, JUDGED_FROM + EPISODES)
    before, after = (
        play_script(player, judged, table.__getitem__)[1] for table in (ANY_CLOSURES, fitted)
    )
    yield from (f"{kind}: {closure}" for kind, closure in fitted.items())
    yield f"before {rate(int(before.sum()), EPISODES)}, after {rate(int(after.sum()), EPISODES)}"
    difference = paired_difference(
        int((after & ~before).sum()), int((before & ~after).sum()), EPISODES
    )
    yield "difference {:+.3f} [{:+.3f}, {:+.3f}]".format(*difference)


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.any_closures", __doc__)
    parser.add_argument(
        "what", choices=("script", "ceiling", "touch"), help="which result to compute"
    )
    parser.add_argument("--objects", choices=SPLITS, default="real", help="split of the ceiling")
    parser.add_argument(
        "--episodes", type=whole_number(1), default=200, help="evaluation episodes per split"
    )
    parser.add_argument(
        "--seed-start",
        type=whole_number(0),
        default=BENCHMARK_SEED,
        help="first seed of the ceiling",
    )
    parser.add_argument(
        "--trials", type=Path, default=Path("runs/touch"), help="folder of the trials of touch"
    )
    parser.add_argument(
        "--first", choices=FIRST, default="policy", help="touch: who decides on the first closure"
    )
    parser.add_argument(
        "--varied-hands",
        action="store_true",
        help="touch: hands that differ, training and held-out ones",
    )
    args = parser.parse_args(argv)
    seeds = range(args.seed_start, args.seed_start + args.episodes)
    parts = {
        "script": script,
        "ceiling": partial(ceiling, args.objects, seeds),
        "touch": partial(touch, args.episodes, args.trials, args.first, args.varied_hands),
    }
    for line in parts[args.what]():
        print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
