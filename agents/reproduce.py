"""Reproduce a table of the documentation: ``python -m agents.reproduce elsewhere --policy FILE
--policy FILE``.

``elsewhere`` evaluates policies on every engine and body with every randomization. ``seeds``
evaluates runs on MuJoCo's *twin*, and ends with the median, the lowest and the interquartile mean,
with its bootstrap interval, of each learner and number of trials with several runs.
``race`` does the same for the algorithms of `agents.race` and the recipe *grasp*: it reads their
policies from the folders ``LEARNER-SEED`` of ``--runs`` and trains missing ones. All cells have the
same held-out episodes and Wilson 95 % intervals; rows are printed when complete."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from agents import POLICY, RecipeError, RunError
from agents.curves import draw_trials
from agents.progress import CURVE
from agents.runs import RUN
from hpac_gym.command import add_counts, command_parser, minutes, run
from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.evaluation.options import DEFAULT_ENV, env_id_of
from hpac_gym.evaluation.statistics import bootstrap_interval, interquartile_mean, rate_text
from hpac_gym.output import markdown, writable_file, writable_results, write_text
from hpac_gym.physics.simulation import SET_UPS, is_installed
from hpac_gym.policies import read_policy
from hpac_gym.policies.loading import needed_options
from hpac_gym.tasks.phases import PHASES

RANDOMIZED = ("nominal", "hand", "full")
RACED = ("learner", "seed", "trials", "time [s]", "success", f"lost in {', '.join(PHASES)}")
Judge = Callable[[str, str, dict[str, str]], dict[str, Any]]
"""Evaluates a policy in an environment with options; returns its entry in the summary."""
Row = tuple[tuple, list[dict[str, Any]]]
"""Texts of a row, and its cells."""


def elsewhere(policies: Sequence[str], judge: Judge) -> Iterator[Row]:
    """A row for each policy, engine and body."""
    for policy in policies:
        for engine, body in (set_up.split("/") for set_up in SET_UPS):
            if engine == "pybullet" and not is_installed("pybullet"):
                continue  # not installed; the command reports it
            options = [
                {"engine": engine, "body": body, "randomize": randomize} for randomize in RANDOMIZED
            ]
            cells = [
                {"policy": policy, **each, **judge(policy, env_id_of(policy), each)}
                for each in options
            ]
            rates = [rate_text(cell["successes"], cell["episodes"]) for cell in cells]
            yield (policy, f"{engine} {body}", *rates), cells


def seeds(policies: Iterable[str], judge: Judge) -> Iterator[Row]:
    """A row for each policy: its learner, seed and training, and its episodes on MuJoCo's
    *twin*.
    """
    for policy in policies:
        about = read_policy(policy).about
        if missing := {"algorithm", "settings", "episodes"} - set(about):
            raise RunError(f"policy file '{policy}' does not tell its {', '.join(sorted(missing))}")
        told = {"learner": about["algorithm"], "seed": about["settings"]["seed"]}
        trials = (
            "of several runs" if len(about["settings"].get("trials_of", ())) > 1 else "of one run"
        )
        trained = {key: about.get(key) for key in ("episodes", "processor_seconds", "seconds")}
        asked = about["settings"].get("episodes")  # None if only time limits the training
        cell = {
            **told,
            "asked": asked,
            "trained": trained,
            "trials": trials,
            **judge(policy, DEFAULT_ENV, {"engine": "mujoco"}),
        }
        lost = ", ".join(str(cell["failures_by_phase"].get(phase, 0)) for phase in PHASES)
        yield (
            (
                *told.values(),
                f"{about['episodes']:,}",
                f"{_seconds(about):,.0f}",
                rate_text(cell["successes"], cell["episodes"]),
                lost,
            ),
            [cell],
        )


def over_runs(cells: Sequence[dict[str, Any]]) -> str:
    """Median, lowest and interquartile mean of the success of several runs."""
    rates = np.array([cell["success_rate"] for cell in cells])
    ends = f"median {100 * np.median(rates):.1f}, lowest {100 * rates.min():.1f}"
    return f"{len(cells)} runs: {ends}, interquartile mean {middle(rates)}"


def middle(rates: np.ndarray) -> str:
    """Interquartile mean of rates, shape (runs,), with its bootstrap interval, in
    percent.
    """
    table = rates[:, None]
    low, high = bootstrap_interval(interquartile_mean, table)
    return f"{100 * float(interquartile_mean(table)):.1f} [{100 * low:.1f}, {100 * high:.1f}]"


def race(runs: Path, learners: Sequence[str], number: int, limit: float) -> Iterator[str]:
    """Policy files of learners, of all by default, for the seeds 0 to `number` − 1; missing ones
    are trained for `limit` minutes.

    Raises:
        RecipeError: A learner is unknown.
    """
    from agents import race, train  # imported here, since they load PyTorch

    known = (*race.CONTENDERS, "grasp")
    if unknown := set(learners) - set(known):
        raise RecipeError(f"unknown learner '{min(unknown)}': known are {', '.join(known)}")
    for name, seed in product(learners or known, range(number)):
        out = runs / f"{name}-{seed}"
        again = "remove it to train it again; its row is left out"
        begun = any((out / file).exists() for file in (RUN, CURVE))
        if not (out / POLICY).exists() and begun:
            print(f"'{out}' was interrupted before its first policy: {again}", file=sys.stderr)
            continue
        if not (out / POLICY).exists() and name == "grasp":
            if train.main(
                ["grasp", "--out", str(out), "--seed", str(seed), "--time-limit", str(limit)]
            ):
                raise KeyboardInterrupt  # the training has taken Ctrl-C, and saved
        elif not (out / POLICY).exists():
            try:
                race.race(name, race.CONTENDERS[name] | {"seed": seed}, out, 60 * limit)
            except RecipeError as missing:
                print(f"{missing}; its row is left out", file=sys.stderr)
                continue
        about = read_policy(out / POLICY).about
        seconds = _seconds(about)
        if seconds < 60 * limit and about["episodes"] < about["settings"].get(
            "episodes", float("inf")
        ):
            print(f"'{out}' was interrupted after {seconds:.0f} s: {again}", file=sys.stderr)
            continue
        yield str(out / POLICY)


def _seconds(about: dict[str, Any]) -> float:
    """Time of a training, of the processor if it was limited so [s]; 0 if it is unknown."""
    return about.get("processor_seconds") or about.get("seconds") or 0.0


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("agents.reproduce", __doc__)
    parser.add_argument("table", choices=("elsewhere", "race", "seeds"), help="which table")
    parser.add_argument(
        "--policy", action="append", help="elsewhere, seeds: a policy file; may be repeated"
    )
    parser.add_argument(
        "--runs", type=Path, default=Path("runs/race"), help="race: folder of the runs"
    )
    parser.add_argument(
        "--learner",
        action="append",
        default=[],
        help="race: a learner; may be repeated; default: all",
    )
    add_counts(
        parser,
        seeds=(1, 1, "race: number of trainings of each learner"),
        episodes=(1, 400, "held-out episodes per cell"),
        workers=(1, 1, "number of processes"),
    )
    parser.add_argument(
        "--minutes", type=minutes, default=15.0, help="race: time of each missing training"
    )
    parser.add_argument("--out", type=Path, help="also write the numbers to this JSON file")
    parser.add_argument(
        "--picture", type=Path, help="race, seeds: also draw success over trials to this PNG file"
    )
    args = parser.parse_args(argv)
    if (args.table != "race") != bool(args.policy):
        parser.error("elsewhere and seeds need at least one --policy, race takes none")
    if args.picture and args.table == "elsewhere":
        parser.error("--picture needs race or seeds")
    if args.out:
        writable_results(args.out, "successes")
    if args.picture:
        writable_file(args.picture)

    def judge(policy: str, env_id: str, options: dict[str, str]) -> dict[str, Any]:
        """Evaluate one policy; returns its entry in the summary."""
        how = {"workers": args.workers, "options": needed_options(policy) | options}
        (cell,) = evaluate([policy], env_id, args.episodes, **how).summary()["policies"].values()
        return cell

    if args.table == "elsewhere":
        columns = ("policy", "judged on", *RANDOMIZED)
        rows = elsewhere(args.policy, judge)
        if not is_installed("pybullet"):
            print("PyBullet is not installed: its rows are left out", file=sys.stderr)
    else:
        files = args.policy or race(args.runs, args.learner, args.seeds, args.minutes)
        columns = RACED
        rows = seeds(files, judge)
    cells: list[dict[str, Any]] = []
    for line, done in rows:
        if not cells:
            print(markdown(columns, ()))
        cells += done
        print(f"| {' | '.join(map(str, line))} |", flush=True)
        if args.out:
            write_text(args.out, json.dumps(cells, indent=2) + "\n")
    groups: dict[tuple, list[dict[str, Any]]] = {}
    for cell in cells:
        groups.setdefault((cell.get("learner"), cell.get("asked")), []).append(cell)
    for (learner, asked), runs in groups.items():
        if learner and len(runs) > 1:
            print(f"\n{learner}{f', at most {asked:,} trials' if asked else ''}: {over_runs(runs)}")
    if args.picture:
        draw_trials(args.picture, cells)


if __name__ == "__main__":
    sys.exit(run(main))
