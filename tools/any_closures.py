"""Headroom of HPAC-GraspAny-v1: ``python -m tools.any_closures``.

Counts the episodes of a split that at least one of several random closures holds. On MuJoCo, with
nominal hands; an episode ends after the shake, which decides its success."""

import sys
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.object_sets import SPLITS
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.envs import HandVectorEnv
from hpac_gym.evaluation.episodes import run_episodes
from hpac_gym.evaluation.seeds import BENCHMARK_SEED
from hpac_gym.evaluation.statistics import rate_text
from hpac_gym.policies import Closures, LearnedPolicy
from hpac_gym.tasks.grasp_any import GraspAny, GraspAnyConfig

LOWEST = np.array([-0.5, 0.2, 0.2, 0.2, 0.2, -0.25, 10.0, -6.0])
HIGHEST = np.array([0.8, 1.0, 1.0, 1.0, 1.0, 0.8, 28.0, 12.0])
"""Bounds of random closures: actions of the six goals, duration and thumb delay [control steps]."""
CLOSURES = Closures(goal=(-1.0, 1.0), duration=(10.0, 28.0), thumb_delay=(-6.0, 12.0))
TRIES = (1, 4, 16, 64)
WORLDS = 64


def worlds_of(objects: str) -> HandVectorEnv:
    """Worlds for the episodes of a split of objects."""
    task = GraspAny(objects, config=GraspAnyConfig(side_time=0.05, ramp_time=0.05))
    return HandVectorEnv(task, WORLDS, "Disabled", engine="mujoco")


def played(envs: HandVectorEnv, seeds: Sequence[int], decisions: NDArray) -> NDArray[np.bool_]:
    """Run the episodes of seeds, each with the closure of its decision, shape (len(seeds), 8), and
    return their successes, shape (len(seeds),).
    """
    won = np.zeros(len(seeds), bool)
    waiting = iter(decisions)
    policy = LearnedPolicy(lambda _: next(waiting), closures=CLOSURES)
    places = iter(range(len(seeds)))
    playing = [0] * envs.num_envs
    for step in run_episodes(envs, [policy] * envs.num_envs, seeds):
        if step.number == 0:
            playing[step.world] = next(places)
        won[playing[step.world]] |= step.success
    return won


def drawn_closure(seed: int, number: int) -> NDArray[np.float64]:
    """Decision of the random closure of a seed and trial number, shape (8,), −1…1."""
    return CLOSURES.decisions(np.random.default_rng([seed, number, 3]).uniform(LOWEST, HIGHEST))


def first_winners(
    play: Callable[[Sequence[int], NDArray], NDArray], seeds: Sequence[int], most: int
) -> dict[int, int]:
    """Number of random closures up to the first success, at most ``most``, by seed; seeds without
    success are absent. `play` is `played` in some worlds, of which there are `WORLDS`.
    """
    tried = dict.fromkeys(seeds, 0)
    tries_of = {}
    while left := [seed for seed in seeds if seed not in tries_of and tried[seed] < most]:
        each = -(-WORLDS // len(left))  # keeps all worlds busy
        jobs = [
            (seed, number)
            for seed in left
            for number in range(tried[seed], min(tried[seed] + each, most))
        ]
        won = play([seed for seed, _ in jobs], np.array([drawn_closure(*j) for j in jobs]))
        for (seed, number), held in zip(jobs, won, strict=True):
            tried[seed] = number + 1
            if held:
                tries_of[seed] = min(number + 1, tries_of.get(seed, most))
    return tries_of


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("tools.any_closures", __doc__)
    parser.add_argument("--objects", choices=SPLITS, default="real", help="split of the objects")
    add_counts(
        parser,
        episodes=(1, 200, "number of evaluation episodes"),
        seed_start=(0, BENCHMARK_SEED, "first seed"),
    )
    args = parser.parse_args(argv)
    seeds = range(args.seed_start, args.seed_start + args.episodes)
    tries_of = first_winners(partial(played, worlds_of(args.objects)), seeds, TRIES[-1])
    for most in TRIES:
        won = sum(tries <= most for tries in tries_of.values())
        print(
            f"{args.objects}, best of {most} random closures: {rate_text(won, len(seeds))} of {len(seeds)}"
        )


if __name__ == "__main__":
    sys.exit(run(main))
