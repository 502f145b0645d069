"""Search a successful closure for every held-out seed of HPAC-Grasp-v0, or the best blind one:
``python -m tools.blind_search``.

For each seed, closures are sampled from the seed's own generator until one holds the object or
`TRIES` are reached. Results are written seed by seed, and a second call resumes where the first
one ended. ``--blind`` instead prints the closure that holds the most episodes of training seeds,
found by successive elimination, and evaluates it on the held-out seeds."""

import sys
from pathlib import Path

import gymnasium
import numpy as np

from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.evaluation import blind
from hpac_gym.evaluation.blind import COLUMNS, FILE, Blind, Closure, Try, share_found
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import rate_text
from hpac_gym.evaluation.workers import worker_pool
from hpac_gym.output import write_text

ENV_ID = "HPAC-Grasp-v0"
TARGET = Path(blind.__file__).parent / "data" / FILE
TRIES = 256
"""Most closures that are tried for a seed."""
ROUNDS = ((128, 4), (32, 12), (8, 40), (2, 120))
"""Remaining closures and additional episodes per closure in each round of the search for a blind
one.
"""

_env: gymnasium.Env


def prepare(engine: str) -> None:
    """Create the environment of this process."""
    global _env
    _env = gymnasium.make(f"hpac_gym:{ENV_ID}", engine=engine)


def holds(closure: Closure, seed: int) -> bool:
    """Whether a closure succeeds in the episode of a seed."""
    *_, last = run_episodes(single(_env), [Blind(_env, closure)], [seed])
    return last.success


def search(seed: int) -> Try:
    """Search the first successful closure of a seed, among at most `TRIES`."""
    rng = np.random.default_rng([seed, 2])
    for tries in range(1, TRIES + 1):
        closure = Closure.drawn(rng)
        if holds(closure, seed):
            return Try(seed, tries, closure)
    return Try(seed, TRIES, None)


def wins(closure: Closure, first_seed: int, episodes: int) -> int:
    """Number of episodes in which a closure succeeds."""
    return sum(holds(closure, first_seed + number) for number in range(episodes))


def search_all(work, seeds: range) -> None:
    """Search and write the closures that are missing in the file."""
    rows = (
        TARGET.read_text(encoding="utf-8").splitlines() if TARGET.exists() else [",".join(COLUMNS)]
    )
    known = {result.seed: result for result in map(Try.of_row, rows[1:])}
    missing = [seed for seed in seeds if seed not in known]
    for result in work(search, ((seed,) for seed in missing)):
        known[result.seed] = result
        ordered = [known[seed].row() for seed in sorted(known)]
        write_text(TARGET, "\n".join([",".join(COLUMNS), *ordered, ""]))
    tries = [known[seed] for seed in seeds]
    for within in (1, 4, 16, 64, TRIES):
        print(
            f"best of {within}: {rate_text(round(share_found(tries, within) * len(tries)), len(tries))}"
        )


def search_blind(work, seeds: range) -> None:
    """Search the best blind closure in ``ROUNDS`` and print it."""
    rng = np.random.default_rng(0)
    met = 0
    field = [(0, Closure.drawn(rng)) for _ in range(ROUNDS[0][0])]
    for left, episodes in ROUNDS:
        field = field[:left]
        won = work(wins, [(closure, met, episodes) for _, closure in field])
        field = sorted(
            ((held + more, closure) for (held, closure), more in zip(field, won, strict=True)),
            key=lambda entry: -entry[0],
        )
        met += episodes
        print(
            f"{left} closures: the best has held {field[0][0]} of {met} episodes",
            file=sys.stderr,
            flush=True,
        )
    best = field[0][1]
    held = sum(work(wins, [(best, seed, 1) for seed in seeds]))
    print(f"{best}\nbest blind closure: {rate_text(held, len(seeds))}")


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("tools.blind_search", __doc__)
    parser.add_argument(
        "--blind", action="store_true", help="search the best blind closure instead"
    )
    parser.add_argument(
        "--seeds",
        type=whole_number(1),
        default=400,
        help=f"number of seeds, from {HELD_OUT_SEED} on",
    )
    parser.add_argument("--engine", default="pybullet", help="physics engine")
    parser.add_argument("--workers", type=whole_number(1), default=1, help="number of processes")
    args = parser.parse_args(argv)
    seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + args.seeds)
    with worker_pool(args.workers, prepare, (args.engine,)) as work:
        (search_blind if args.blind else search_all)(work, seeds)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
