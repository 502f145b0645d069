"""``hpac benchmark``: the benchmark's protocol.

Evaluates a policy on every split of an environment, with fixed seeds, and writes a results file. A
trained method needs five runs of one budget: ``{seed}`` in the name of its policy stands for 0 to
4. An untrained policy has one run. An interrupted call continues after the last finished cell. Where PyBullet is not
installed, its splits are left out, and the file says so.
``--check FILE`` reports every fault of results files or prints their tables, and for two files with
the same environment which of them is better."""

import argparse
import json
import os
import shlex
import sys
import warnings
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.command import whole_number
from hpac_gym.evaluation.environment import make_env, versions
from hpac_gym.evaluation.evaluate import evaluate, failures_by_phase
from hpac_gym.evaluation.results import (
    comparison,
    faults,
    faults_of_cells,
    over_budget,
    read,
    summary,
    table,
    wrong_seeds,
)
from hpac_gym.evaluation.seeds import BENCHMARK_SEED, HELD_OUT_SEED
from hpac_gym.evaluation.splits import (
    EPISODES,
    RUNS,
    SCHEMA,
    SPLITS,
    Results,
    ResultsError,
    env_hash,
    from_before,
    judged_splits,
    splits_of,
)
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.output import file_hash, writable_file, write_text
from hpac_gym.physics.simulation import is_installed
from hpac_gym.policies.loading import NAMES, NORMALIZE, about, load_policy
from hpac_gym.policies.onnx_model import MODEL


def header(args: argparse.Namespace) -> Results:
    """The fields of a results file that are known before the first episode."""
    budget = int(float(args.budget))
    if budget and "{seed}" not in args.policy:
        raise ResultsError(
            f"policy '{args.policy}' of budget {budget:,} contains no {{seed}}: a trained method needs {RUNS} runs"
        )
    for fault in wrong_seeds(*args.training_seeds):  # told before the long run
        raise ResultsError(fault)
    seeds = list(range(RUNS if budget else 1))
    runs = [(_seeded(args.policy, seed), _seeded(args.normalize, seed)) for seed in seeds]
    told = [about(name, statistics) for name, statistics in runs]
    weights = [one.get("sha256", one.get("weights_sha256")) for one in told if one]
    if len(set(weights)) < len(weights):
        raise ResultsError(
            f"policy '{args.policy}': two of its {RUNS} runs have the same weights; each needs a seed of its own"
        )
    splits = splits_of(args.env)
    judged = [split for split in splits if is_installed(splits[split].get("engine", "mujoco"))]
    left_out = [split for split in splits if split not in judged]
    if left_out:
        warnings.warn(
            f"PyBullet is not installed: the file will lack {', '.join(left_out)}", stacklevel=2
        )
    for split in judged:
        with make_env(args.env, **_options(args.env, split, args.obs)) as env:
            for name, statistics in runs:
                load_policy(name, env, statistics)  # errors are raised before the long run
    return {
        "schema": SCHEMA,
        "env_id": args.env,
        "env_sha256": env_hash(args.env),
        "policy": args.policy,
        "files": [_file(name, facts) for (name, _), facts in zip(runs, told, strict=True) if facts],
        "about": args.about,
        "budget": budget,
        "training_seeds": args.training_seeds if budget else None,
        "seeds": seeds,
        "obs": args.obs,
        "episodes": args.episodes,
        "first_seed": BENCHMARK_SEED,
        "versions": versions(),
        **({"left_out": left_out} if left_out else {}),
        **({"normalize": args.normalize} if args.normalize else {}),
    }


def _options(env_id: str, split: str, obs: str) -> dict[str, str]:
    return splits_of(env_id)[split] | ({} if obs == "deploy" else {"obs": obs})


def _seeded(name: str | None, seed: int) -> str | None:
    return name and name.replace("{seed}", str(seed))


def _file(name: str, told: dict[str, Any]) -> dict[str, Any]:
    # A policy file has that of its weights: a resumed training writes the same ones into another file.
    digest = told.get("sha256") or file_hash(Path(name) / MODEL, ResultsError)
    told = told.get("training", told)  # of an exported policy
    keys = ("algorithm", "env_steps", "seed", "normalize_sha256")
    return {"sha256": digest, **{key: told[key] for key in keys if key in told}}


def judge(head: Results, split: str, seed: int, workers: int) -> Results:
    """Evaluate one cell: the episodes of one run on one split."""
    options = _options(head["env_id"], split, head["obs"])
    result = evaluate(
        [_seeded(head["policy"], seed)],
        head["env_id"],
        head["episodes"],
        seed_start=head["first_seed"],
        workers=workers,
        options=options,
        normalize=_seeded(head.get("normalize"), seed),
    )
    episodes = next(iter(result.episodes.values()))
    won = sum(episode.success for episode in episodes)
    forces = [episode.holding_force for episode in episodes]
    return {
        "split": split,
        "seed": seed,
        "successes": won,
        "interval_95": list(wilson_interval(won, len(episodes))),
        "failures": dict(failures_by_phase(episodes)),
        "holding_force": None if None in forces else float(np.mean(forces)),
    }


def check(paths: Sequence[Path], as_json: bool = False) -> int:
    """Print the faults of results files, or their tables, or both as one JSON object; returns the
    exit status, 1 if there are faults.
    """
    files = [read(path) for path in paths]
    all_faults = [list(faults(results)) for results in files]
    rows = list(zip(map(str, paths), all_faults, files, strict=True))
    if as_json:
        told = [
            {"path": path, "faults": bad, "summary": results.get("summary")}
            for path, bad, results in rows
        ]
        print(json.dumps({"files": told}))
    else:
        for path, bad, results in rows:
            told = "\n".join(f"{path}: {fault}" for fault in bad)
            print(told or f"{path}: valid\n\n{table(results)}\n")
        if not any(all_faults) and len(files) == 2 and files[0]["env_id"] == files[1]["env_id"]:
            print(comparison(*files))
    return int(any(all_faults))


def judge_all(args: argparse.Namespace) -> Results:
    """Evaluate every cell that the file does not contain yet, and write the file after each."""
    head = header(args)
    for fault in over_budget(head):
        print(f"no submission: {fault} (--budget names a larger one)", file=sys.stderr)
    results = read(args.out) if os.path.exists(args.out) else head | {"cells": []}
    if results.get("env_id") == head["env_id"] and from_before(results):
        results["env_sha256"] = head["env_sha256"]
    for name, value in head.items():
        if results.get(name) != value:
            raise ResultsError(
                f"'{args.out}' holds results with {name} {results.get(name)!r}, not {value!r}: name another file"
            )
    writable_file(args.out)
    wanted = [(seed, split) for seed in head["seeds"] for split in judged_splits(head)]
    try:
        done = Counter((cell["seed"], cell["split"]) for cell in results["cells"])
        bad = next(faults_of_cells(results, done, set(wanted)), None)
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        bad = repr(error)
    if bad:
        raise ResultsError(f"cannot continue results file '{args.out}': {bad}")
    for number, (seed, split) in enumerate(wanted, 1):
        if (seed, split) not in done:
            cell = judge(head, split, seed, args.workers)
            results["cells"].append(cell)
            write_text(args.out, json.dumps(results, indent=1) + "\n")
            rate = cell["successes"] / head["episodes"]
            print(
                f"cell {number} of {len(wanted)}: seed {seed}, {split}: {rate:.1%}", file=sys.stderr
            )
    results |= {
        "command": f"hpac benchmark {shlex.join(sys.argv[2:])}",
        "summary": summary(results),
    }
    write_text(args.out, json.dumps(results, indent=1) + "\n")
    return results


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac benchmark`."""
    parser.add_argument("env", nargs="?", help=f"one of {', '.join(SPLITS)}")
    parser.add_argument(
        "--policy",
        help=f"{NAMES}; {{seed}} in it stands for the seed of a run",
    )
    parser.add_argument("--normalize", metavar="FILE", help=f"{NORMALIZE}; {{seed}} as in --policy")
    parser.add_argument(
        "--budget", choices=("0", "1e5", "1e6", "1e7"), default="0", help="steps of each training"
    )
    parser.add_argument(
        "--training-seeds",
        type=int,
        nargs=2,
        default=[0, HELD_OUT_SEED - 1],
        metavar=("FIRST", "LAST"),
        help=f"first and last seed of the training episodes (default: 0 {HELD_OUT_SEED - 1})",
    )
    parser.add_argument("--obs", default="deploy", help="observation mode of the policy")
    parser.add_argument("--about", default="", help="a line on the method, with a link to its code")
    parser.add_argument(
        "--episodes", type=whole_number(1), default=EPISODES, help="episodes per cell"
    )
    parser.add_argument("--workers", type=whole_number(1), default=1, help="number of processes")
    parser.add_argument("--out", type=Path, help="results file; an existing one is continued")
    parser.add_argument(
        "--check", type=Path, nargs="+", metavar="FILE", help="check results files instead"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of tables")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Run the command: evaluate every cell, or check results files."""
    needed = {"an environment": args.env, "--policy": args.policy, "--out": args.out}
    if args.check:
        if given := [name for name, value in needed.items() if value]:
            raise ResultsError(
                f"--check judges nothing anew: it goes without {' and '.join(given)}"
            )
        return check(args.check, args.json)
    if missing := [name for name, given in needed.items() if not given]:
        raise ResultsError(f"{' and '.join(missing)} must be given, or --check alone")
    results = judge_all(args)
    print(json.dumps(results) if args.json else table(results))
    return 0
