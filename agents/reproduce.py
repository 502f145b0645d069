"""Make a table of the documentation again: ``python -m agents.reproduce elsewhere --policy FILE --policy FILE``.

``elsewhere`` judges policies on every engine and body, with every randomization. ``race`` judges the contenders of `agents.race`
and the recipe *grasp* on MuJoCo's *twin*; it takes their policies from the folders ``CONTENDER-SEED`` of ``--runs`` and trains
those that are missing. The same held-out episodes in each cell, Wilson 95 % intervals; lines are printed as they are done.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from agents.command import command_parser, minutes
from agents.evaluate import DEFAULT_TASK, LEARNED, evaluate
from hpac import run, whole_number
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.output import writable_folder, write_text
from hpac_gym.physics.simulation import default_engine
from hpac_gym.policies import read_policy
from hpac_gym.policies.baselines import BASELINES

PLACES = (("pybullet", "twin"), ("mujoco", "twin"), ("mujoco", "light"))
RANDOMIZED = ("nominal", "hand", "full")
PHASES = ("close", "lift", "shake", "place")
RACED = ("learner", "seed", "trials", "time [s]", "success [%]", f"lost in {', '.join(PHASES)}")


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


def race(runs: Path, seed: int, limit: float, episodes: int, seed_start: int, workers: int) -> Iterator[dict[str, Any]]:
    """The rows of the table of the race, as they are done."""
    from agents import race, train  # here, since they load PyTorch

    for name in (*race.CONTENDERS, "grasp"):
        out = runs / f"{name}-{seed}"
        if not (out / train.POLICY).exists() and name == "grasp":
            train.main(["grasp", "--out", str(out), "--seed", str(seed), "--time-limit", str(limit)])
        elif not (out / train.POLICY).exists():
            race.race(name, out, seed, 60 * limit)
        options = {"engine": race.ENGINE}
        policy = str(out / train.POLICY)
        judged = evaluate([policy], DEFAULT_TASK, episodes, seed_start=seed_start, workers=workers, options=options)
        about = {key: read_policy(policy).about.get(key) for key in ("episodes", "processor_seconds", "seconds")}
        yield {"contender": name, "seed": seed, "trained": about, **options, **judged.summary()["policies"][LEARNED]}


def race_row(cell: dict[str, Any]) -> str:
    """A row of the table of the race in Markdown."""
    phases, trained = cell["failures_by_phase"], cell["trained"]
    lost = ", ".join(str(phases.get(phase, 0)) for phase in PHASES)
    seconds = trained["processor_seconds"] or trained["seconds"]
    return f"| {cell['contender']} | {cell['seed']} | {trained['episodes']:,} | {seconds:,.0f} | {_rate(cell)} | {lost} |"


def row(cells: Sequence[dict[str, Any]]) -> str:
    """A row of the table in Markdown: a policy at one engine and body."""
    first = cells[0]
    return f"| {first['policy']} | {first['engine']} {first['body']} | {' | '.join(map(_rate, cells))} |"


def _rate(cell: dict[str, Any]) -> str:
    low, high = cell["interval_95"]
    return f"{100 * cell['success_rate']:.1f} [{100 * low:.0f}, {100 * high:.0f}]"


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.reproduce", __doc__)
    parser.add_argument("table", choices=("elsewhere", "race"), help="which table")
    parser.add_argument("--policy", action="append", help="elsewhere: a policy file, random or scripted; may be repeated")
    parser.add_argument("--runs", type=Path, default=Path("runs/race"), help="race: folder of the runs")
    parser.add_argument("--seed", type=whole_number(0), default=0, help="race: of the trainings")
    parser.add_argument("--minutes", type=minutes, default=15.0, help="race: of each training that is missing")
    parser.add_argument("--episodes", type=whole_number(1), default=400, help="held-out episodes of each cell")
    parser.add_argument("--seed-start", type=whole_number(0), default=HELD_OUT_SEED, help="seed of the first episode")
    parser.add_argument("--workers", type=whole_number(1), default=1, help="processes")
    parser.add_argument("--out", type=Path, help="write the numbers to this JSON file too")
    args = parser.parse_args(argv)
    if (args.table == "elsewhere") != bool(args.policy):
        parser.error("elsewhere needs at least one --policy, race takes none")
    if args.out:
        writable_folder(args.out.parent)
    how = args.episodes, args.seed_start, args.workers
    if args.table == "race":
        columns, group, line = RACED, 1, lambda done: race_row(done[0])
        found = race(args.runs, args.seed, args.minutes, *how)
    else:
        columns, group, line = ("policy", "judged on", *RANDOMIZED), len(RANDOMIZED), row
        found = elsewhere(args.policy, *how)
        if default_engine() != "pybullet":
            print("PyBullet is not installed: its rows are left out", file=sys.stderr)
    print(f"| {' | '.join(columns)} |")
    print("| --- " * len(columns) + "|")
    cells: list[dict[str, Any]] = []
    for cell in found:
        cells.append(cell)
        if len(cells) % group == 0:
            print(line(cells[-group:]), flush=True)
        if args.out:
            write_text(args.out, json.dumps(cells, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
