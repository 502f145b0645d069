"""Make a table of the documentation again: ``python -m agents.reproduce elsewhere --policy FILE --policy FILE``.

``elsewhere`` judges policies, and the script beside them, on every engine and body, with every randomization: the same held-out
episodes in each cell, Wilson 95 % intervals. Lines go to standard output as they are done.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from agents.command import command_parser
from agents.evaluate import DEFAULT_TASK, LEARNED, evaluate
from hpac import run, whole_number
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.output import writable_folder, write_text
from hpac_gym.physics.simulation import default_engine
from hpac_gym.policies import read_policy
from hpac_gym.policies.baselines import BASELINES

PLACES = (("pybullet", "twin"), ("mujoco", "twin"), ("mujoco", "light"))
RANDOMIZED = ("nominal", "hand", "full")


def elsewhere(policies: Sequence[str], episodes: int, seed_start: int, workers: int) -> Iterator[dict[str, Any]]:
    """The cells of the table, as they are done."""
    for policy in policies:
        env_id = DEFAULT_TASK if policy in BASELINES else read_policy(policy).about["env_id"]
        for engine, body in PLACES:
            if engine == "pybullet" and default_engine() != "pybullet":
                continue  # not installed; the table then says so
            for randomize in RANDOMIZED:
                options = {"engine": engine, "body": body, "randomize": randomize}
                judged = evaluate([policy], env_id, episodes, seed_start=seed_start, workers=workers, options=options)
                numbers = judged.summary()["policies"][policy if policy in BASELINES else LEARNED]
                yield {"policy": policy, **options, **numbers}


def row(cells: Sequence[dict[str, Any]]) -> str:
    """A row of the table in Markdown: a policy at one engine and body."""
    first, rates = cells[0], []
    for cell in cells:
        low, high = cell["interval_95"]
        rates.append(f"{100 * cell['success_rate']:.1f} [{100 * low:.0f}, {100 * high:.0f}]")
    return f"| {first['policy']} | {first['engine']} {first['body']} | {' | '.join(rates)} |"


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.reproduce", __doc__)
    parser.add_argument("table", choices=("elsewhere",), help="which table")
    parser.add_argument("--policy", action="append", required=True, help="a policy file, random or scripted; may be repeated")
    parser.add_argument("--episodes", type=whole_number(1), default=400, help="held-out episodes of each cell")
    parser.add_argument("--seed-start", type=whole_number(0), default=HELD_OUT_SEED, help="seed of the first episode")
    parser.add_argument("--workers", type=whole_number(1), default=1, help="processes")
    parser.add_argument("--out", type=Path, help="write the numbers to this JSON file too")
    args = parser.parse_args(argv)
    if args.out:
        writable_folder(args.out.parent)
    if default_engine() != "pybullet":
        print("PyBullet is not installed: its rows are left out", file=sys.stderr)
    print(f"| policy | judged on | {' | '.join(RANDOMIZED)} |")
    print("| --- " * (2 + len(RANDOMIZED)) + "|")
    cells: list[dict[str, Any]] = []
    for cell in elsewhere(args.policy, args.episodes, args.seed_start, args.workers):
        cells.append(cell)
        if len(cells) % len(RANDOMIZED) == 0:
            print(row(cells[-len(RANDOMIZED) :]), flush=True)
        if args.out:
            write_text(args.out, json.dumps(cells, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
