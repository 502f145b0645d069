"""Search a successful closure for every held-out seed of HPAC-Grasp-v0, or the best blind one:
``python -m tools.blind_search``.

For each seed, closures are sampled from the seed's own generator until one holds the object or
`TRIES` are reached. Results are written seed by seed, and a second call resumes where the first
one ended. ``--blind`` instead prints the closure that holds the most episodes of training seeds,
found by successive elimination, and evaluates it on the held-out seeds."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import gymnasium
import numpy as np

from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.evaluation.blind import Blind
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import rate_text
from hpac_gym.evaluation.workers import shared
from hpac_gym.model import SERVO_INDEX, SERVOS
from hpac_gym.output import write_text
from hpac_gym.physics.simulation import ENGINES

ENV_ID = "HPAC-Grasp-v0"
TARGET = Path(__file__).with_name("grasp_closures.csv")
COLUMNS = ("seed", "tries", *SERVOS, "steps", "lead")
Closure = tuple[float, ...]
"""As `hpac_gym.evaluation.blind.action` takes it."""
TRIES = 256
"""Most closures that are tried for a seed."""
ROUNDS = ((128, 4), (32, 12), (8, 40), (2, 120))
"""Remaining closures and additional episodes per closure in each round of the search for a blind
one.
"""


@dataclass(frozen=True, slots=True)
class Try:
    """Result of the search for one held-out seed."""

    seed: int
    tries: int
    """Number of closures tried, up to the first success."""
    closure: Closure | None
    """The first successful closure; None if none succeeded."""

    def row(self) -> str:
        """The result as a line of the file."""
        values = self.closure or [""] * (len(COLUMNS) - 2)
        return ",".join(map(str, (self.seed, self.tries, *values)))

    @classmethod
    def of_row(cls, row: str) -> "Try":
        """Parse a line of the file."""
        seed, tries, *values = row.split(",")
        if not values[0]:
            return cls(int(seed), int(tries), None)
        return cls(int(seed), int(tries), tuple(map(float, values)))


def winning_closures() -> list[Try]:
    """Entries of the committed file, one per held-out seed."""
    _, *rows = TARGET.read_text(encoding="utf-8").splitlines()
    return [Try.of_row(row) for row in rows]


def share_found(tries: Sequence[Try], within: int) -> float:
    """Share of the seeds for which one of the first ``within`` closures succeeded."""
    return float(np.mean([found.closure is not None and found.tries <= within for found in tries]))


def drawn(rng: np.random.Generator) -> Closure:
    """A random closure to targets between half open and closed, in 0.4 to 1.1 s."""
    goal = rng.uniform(-0.2, 1.0, len(SERVOS))
    goal[SERVO_INDEX["thumb_cmc"]] = rng.uniform(-0.2, 0.9)
    steps = rng.uniform(8.0, 22.0)
    lead = rng.uniform(-6.0, 6.0)
    return (*goal.round(3).tolist(), round(steps, 2), round(lead, 2))


@cache
def _env(engine: str) -> gymnasium.Env:
    """The environment of this process."""
    return gymnasium.make(f"hpac_gym:{ENV_ID}", engine=engine)


def holds(closure: Closure, seed: int, engine: str) -> bool:
    """Whether a closure succeeds in the episode of a seed."""
    env = _env(engine)
    *_, last = run_episodes(single(env), [Blind(env, closure)], [seed])
    return last.success


def search(seed: int, engine: str) -> Try:
    """Search the first successful closure of a seed, among at most `TRIES`."""
    rng = np.random.default_rng([seed, 2])
    for tries in range(1, TRIES + 1):
        closure = drawn(rng)
        if holds(closure, seed, engine):
            return Try(seed, tries, closure)
    return Try(seed, TRIES, None)


def wins(closure: Closure, first_seed: int, episodes: int, engine: str) -> int:
    """Number of episodes in which a closure succeeds."""
    return sum(holds(closure, first_seed + number, engine) for number in range(episodes))


def search_all(seeds: range, engine: str, workers: int) -> None:
    """Search and write the closures that are missing in the file."""
    known = {result.seed: result for result in winning_closures()}
    missing = [seed for seed in seeds if seed not in known]
    for result in shared(search, ((seed, engine) for seed in missing), workers):
        known[result.seed] = result
        ordered = [known[seed].row() for seed in sorted(known)]
        write_text(TARGET, "\n".join([",".join(COLUMNS), *ordered, ""]))
    tries = [known[seed] for seed in seeds]
    for within in (1, 4, 16, 64, TRIES):
        print(
            f"best of {within}: {rate_text(round(share_found(tries, within) * len(tries)), len(tries))}"
        )


def search_blind(seeds: range, engine: str, workers: int) -> None:
    """Search the best blind closure in ``ROUNDS`` and print it."""
    rng = np.random.default_rng(0)
    met = 0
    field = [(0, drawn(rng)) for _ in range(ROUNDS[0][0])]
    for left, episodes in ROUNDS:
        field = field[:left]
        won = shared(wins, [(closure, met, episodes, engine) for _, closure in field], workers)
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
    held = sum(shared(holds, [(best, seed, engine) for seed in seeds], workers))
    print(f"{best}\nbest blind closure: {rate_text(held, len(seeds))}")


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("tools.blind_search", __doc__)
    parser.add_argument(
        "--blind", action="store_true", help="search the best blind closure instead"
    )
    add_counts(
        parser,
        seeds=(1, 400, f"number of seeds, from {HELD_OUT_SEED} on"),
        workers=(1, 1, "number of processes"),
    )
    parser.add_argument(
        "--engine", choices=ENGINES, default="pybullet", help="physics engine; of --blind"
    )
    args = parser.parse_args(argv)
    if args.engine != "pybullet" and not args.blind:
        parser.error(
            f"--engine is '{args.engine}': the closures of {TARGET.name} are of pybullet alone"
        )
    seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + args.seeds)
    find = search_blind if args.blind else search_all
    find(seeds, args.engine, args.workers)


if __name__ == "__main__":
    sys.exit(run(main))
