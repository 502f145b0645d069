"""``hpac benchmark``: the benchmark's protocol.

Evaluates a policy on every split of an environment, with fixed seeds, and writes a results file. A
trained method needs five runs of one budget: ``{seed}`` in the name of its policy stands for 0 to
4. An untrained policy has one run. An interrupted call continues after the last finished cell. Where PyBullet is not
installed, its splits are left out, and the file says so.
``--check FILE`` reports every fault of results files or prints their tables, and for two files with
the same environment which of them is better."""

import argparse
import hashlib
import json
import math
import sys
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.body.object_sets import object_set
from hpac_gym.command import Formatter, whole_number
from hpac_gym.envs.models import FILES
from hpac_gym.envs.options import CALIBRATED
from hpac_gym.errors import EnvError, HpacError
from hpac_gym.evaluation.environment import make_env, versions
from hpac_gym.evaluation.evaluate import NO_PHASE, evaluate, failures_by_phase
from hpac_gym.evaluation.seeds import BENCHMARK_SEED, HELD_OUT_SEED
from hpac_gym.evaluation.statistics import (
    interquartile_mean,
    probability_of_improvement,
    stratified_bootstrap,
    wilson_interval,
)
from hpac_gym.output import markdown, writable_file, write_text
from hpac_gym.physics.simulation import is_installed
from hpac_gym.policies.loading import NAMES, NORMALIZE, about, load_policy
from hpac_gym.policies.made_for import made_for
from hpac_gym.policies.policy_file import policy_path
from hpac_gym.registration import GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE
from hpac_gym.tasks.grasp_types import data_text

SCHEMA = "hpac-benchmark-1"
BUDGETS = (0, 100_000, 1_000_000, 10_000_000)
"""Permitted budgets of environment steps per training; 0 means untrained."""
RUNS = 5
EPISODES = 1_000
"""Required runs of a trained method and episodes per cell."""
CALIBRATED_HANDS = "real objects, held-out hands, calibrated"
ADDED: dict[str, tuple[str, ...]] = {GRASP_ANY: (CALIBRATED_HANDS,)}
"""Splits that an id was given later. A file from before has the hash of a definition without them,
and stays valid as a partial one; `hpac benchmark` adds their cells to it.
"""
_TWIN = {"engine": "mujoco", "body": "twin"}
_REAL = _TWIN | {"objects": "real"}
_TYPES = _TWIN | {"types": "train", "objects": "train"}
_HANDS = _TWIN | {"randomize": "hand"}
_PRIMITIVES = {
    "nominal": _TWIN,
    "hands that differ": _HANDS,
    "all that differs": _TWIN | {"randomize": "full"},
    "light body": _TWIN | {"body": "light"},
    "PyBullet": _TWIN | {"engine": "pybullet"},
}
SPLITS: dict[str, dict[str, dict[str, str]]] = {
    GRASP: _PRIMITIVES,
    PICK_PLACE: _PRIMITIVES,
    GRASP_ANY: {
        "training objects": _TWIN | {"objects": "train"},
        "held-out objects": _TWIN | {"objects": "test"},
        "real objects": _REAL,
        "real objects, training hands": _REAL | {"hands": "train"},
        "real objects, held-out hands": _REAL | {"hands": "test"},
        CALIBRATED_HANDS: _REAL | {"hands": "test", "model": CALIBRATED},
        "real objects, light body": _REAL | {"body": "light"},
        "real objects, PyBullet": _REAL | {"engine": "pybullet"},
    },
    GRASP_TYPE: {
        "training types and objects": _TYPES,
        "held-out objects": _TYPES | {"objects": "test"},
        "held-out types": _TYPES | {"types": "test"},
        "held-out types and objects": _TYPES | {"types": "test", "objects": "test"},
        "hands that differ": _TYPES | {"randomize": "hand"},
        "light body": _TYPES | {"body": "light"},
        "PyBullet": _TYPES | {"engine": "pybullet"},
    },
    POSTURE: {
        "hands that differ": _HANDS,
        "nominal": _TWIN | {"randomize": "nominal"},
        "all that differs": _TWIN | {"randomize": "full"},
        "light body": _HANDS | {"body": "light"},
        "PyBullet": _HANDS | {"engine": "pybullet"},
    },
}
"""Options of the environment in each split, by id; each split changes one factor."""

Results = dict[str, Any]


class ResultsError(HpacError, OSError):
    """A results file cannot be read, written or continued."""


def splits_of(env_id: str) -> dict[str, dict[str, str]]:
    """The splits of an id.

    Raises:
        EnvError: The environment has no benchmark.
    """
    if env_id not in SPLITS:
        raise EnvError(f"environment '{env_id}' has no benchmark: known are {', '.join(SPLITS)}")
    return SPLITS[env_id]


@cache
def env_hash(env_id: str, without: Sequence[str] = ()) -> str:
    """SHA-256 of the definition of a benchmark environment: splits, observation, task, hand,
    objects, and the files of calibrated hands; `without` names splits that it leaves out.
    """
    splits = {split: of for split, of in splits_of(env_id).items() if split not in without}
    with make_env(env_id, **next(iter(splits.values()))) as env:
        told: Results = {"splits": splits, "made_for": made_for(env)}
    if env_id == GRASP_TYPE:
        told["types"] = data_text()
    if any(options.get("model") == CALIBRATED for options in splits.values()):
        told["calibrated"] = [path.read_text("utf-8") for path in sorted(FILES.glob("*.toml"))]
    for name in (
        sorted({options["objects"] for options in splits.values()}) if env_id == GRASP_ANY else ()
    ):
        told[name] = [
            [
                entry.name,
                entry.friction,
                float(entry.model.mass),
                np.round([pose.quaternion for pose in entry.poses], 9).tolist(),
            ]
            for entry in object_set(name)
        ]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def header(args: argparse.Namespace) -> Results:
    """The fields of a results file that are known before the first episode."""
    budget = int(float(args.budget))
    if budget and "{seed}" not in args.policy:
        raise ResultsError(
            f"policy '{args.policy}' of budget {budget:,} contains no {{seed}}: a trained method needs {RUNS} runs"
        )
    seeds = list(range(RUNS if budget else 1))
    names = [args.policy.replace("{seed}", str(seed)) for seed in seeds]
    normalize = [_seeded(args.normalize, seed) for seed in seeds]
    left_out = [
        split
        for split, options in splits_of(args.env).items()
        if split not in _required(args.env) and not is_installed(options["engine"])
    ]
    if left_out:
        warnings.warn(
            f"PyBullet is not installed: the file will lack {', '.join(left_out)}", stacklevel=2
        )
    for split in splits_of(args.env):  # raises errors before the long run
        if split in left_out:
            continue
        with make_env(args.env, **_options(args.env, split, args.obs)) as env:
            for name, statistics in zip(names, normalize, strict=True):
                load_policy(name, env, statistics)
    return {
        "schema": SCHEMA,
        "env_id": args.env,
        "env_sha256": env_hash(args.env),
        "policy": args.policy,
        "files": [
            _file(name, statistics)
            for name, statistics in zip(names, normalize, strict=True)
            if policy_path(name).is_file()
        ],
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


def _required(env_id: str) -> list[str]:
    """The splits of an id that no results file may leave out: all but those of PyBullet, which
    many systems cannot install."""
    return [
        split for split, options in splits_of(env_id).items() if options.get("engine") != "pybullet"
    ]


def judged_splits(results: Results) -> list[str]:
    """The splits that a results file has, in order."""
    left_out = lacking(results)
    return [split for split in splits_of(results["env_id"]) if split not in left_out]


def lacking(results: Results) -> list[str]:
    """The splits that a results file lacks: those it says it left out, and those that were added
    after it was made.
    """
    return [*results.get("left_out", []), *(ADDED[results["env_id"]] if _early(results) else ())]


def _early(results: Results) -> bool:
    """Whether a results file is from before its environment was given more splits."""
    added = ADDED.get(results["env_id"], ())
    return bool(added) and results.get("env_sha256") == env_hash(results["env_id"], added)


def _options(env_id: str, split: str, obs: str) -> dict[str, str]:
    return splits_of(env_id)[split] | ({} if obs == "deploy" else {"obs": obs})


def _seeded(name: str | None, seed: int) -> str | None:
    return name and name.replace("{seed}", str(seed))


def _file(name: str, normalize: str | None) -> dict[str, Any]:
    told = about(name, normalize)
    digest = hashlib.sha256(policy_path(name).read_bytes()).hexdigest()
    keys = ("algorithm", "env_steps", "seed", "normalize_sha256")
    return {"sha256": digest, **{key: told[key] for key in keys if key in told}}


def judge(head: Results, split: str, seed: int, workers: int) -> Results:
    """Evaluate one cell: the episodes of one run on one split."""
    options = _options(head["env_id"], split, head["obs"])
    name = head["policy"].replace("{seed}", str(seed))
    result = evaluate(
        [name],
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


def summary(results: Results) -> list[Results]:
    """Interquartile mean of the success over the runs, with its bootstrap interval, for each split
    and for all splits.
    """
    scores = _scores(results)
    names = [*judged_splits(results), "all splits"]
    tables = [*np.split(scores, scores.shape[1], axis=1), scores]
    iqm = interquartile_mean
    interval = partial(stratified_bootstrap, interquartile_mean)
    return [
        {"split": name, "iqm": float(iqm(table)), "interval_95": list(interval(table))}
        for name, table in zip(names, tables, strict=True)
    ]


def _scores(results: Results, splits: Sequence[str] | None = None) -> np.ndarray:
    """Success rates, shape (runs, splits); of all splits that were judged by default."""
    won = {
        (cell["seed"], cell["split"]): cell["successes"] / results["episodes"]
        for cell in results["cells"]
    }
    return np.array(
        [
            [won[seed, split] for split in splits or judged_splits(results)]
            for seed in results["seeds"]
        ]
    )


def _over_budget(results: Results) -> Iterator[str]:
    for file in results["files"]:
        if (steps := file.get("env_steps", 0)) > results["budget"]:
            yield f"a policy file was trained for {steps:,} steps, over the budget of {results['budget']:,}"


def faults(results: Results) -> Iterator[str]:
    """Every fault of the contents of a results file, one line each."""
    try:
        if results["schema"] != SCHEMA:
            yield f"schema is {results['schema']!r}, not {SCHEMA!r}"
            return
        yield from _header_faults(results)
        splits = judged_splits(results)
        counted = Counter((cell["seed"], cell["split"]) for cell in results["cells"])
        wanted = {(seed, split) for seed in results["seeds"] for split in splits}
        yield from (
            f"split '{split}' of seed {seed} is missing"
            for seed, split in sorted(wanted - set(counted))
        )
        yield from _faults_of_cells(results, counted, wanted)
        if set(counted) == wanted and not _same(results["summary"], summary(results)):
            yield "summary does not follow from the cells"
    except KeyError as error:
        yield f"field {error} is missing"
    except (TypeError, ValueError, AttributeError) as error:
        yield f"a field has the wrong type: {error}"


def _header_faults(results: Results) -> Iterator[str]:
    first = results["first_seed"]
    episodes = results["episodes"]
    budget = results["budget"]
    here = env_hash(results["env_id"])
    if results["env_sha256"] != here and not _early(results):
        yield f"env_sha256 {results['env_sha256'][:12]}… is not that of this version of {results['env_id']}, {here[:12]}…"
    if budget not in BUDGETS:
        yield f"budget is {budget}: it must be one of {', '.join(f'{budget:,}' for budget in BUDGETS)} steps"
    if results["seeds"] != list(range(RUNS if budget else 1)):
        yield f"seeds are {results['seeds']}: a trained policy has {RUNS} from 0 on, an untrained one only 0"
    if episodes < EPISODES:
        yield f"episodes are {episodes}: a submission has at least {EPISODES:,} in each cell"
    if first != BENCHMARK_SEED:
        yield f"first_seed is {first}, not {BENCHMARK_SEED}"
    for split in set(results.get("left_out", [])) - set(splits_of(results["env_id"])):
        yield f"left_out names '{split}', which is no split"
    for split in set(results.get("left_out", [])) & set(_required(results["env_id"])):
        yield f"split '{split}' is left out: only those of PyBullet may be"
    if budget:
        low, high = results["training_seeds"]
        if low <= first + episodes - 1 and high >= first:
            yield f"training seeds {low} to {high} overlap the evaluation seeds, from {first} on"
    yield from _over_budget(results)
    if len({file["sha256"] for file in results["files"]}) != len(results["files"]):
        yield "two runs have the same policy file"
    missing = {"hpac_gym", "python", "mujoco-core"} - results["versions"].keys()
    yield from (f"version of {name} is missing" for name in sorted(missing))


def _faults_of_cells(
    results: Results, counted: Counter[tuple], wanted: Set[tuple]
) -> Iterator[str]:
    """Faults of the cells that are there, which are `counted` by seed and split."""
    yield from (
        f"split '{split}' of seed {seed} is unexpected"
        for seed, split in sorted(set(counted) - wanted)
    )
    yield from (
        f"split '{cell[1]}' of seed {cell[0]} occurs {count} times"
        for cell, count in counted.items()
        if count > 1
    )
    for cell in results["cells"]:
        yield from (
            f"split '{cell['split']}' of seed {cell['seed']}: {fault}"
            for fault in _cell_faults(cell, results)
        )


def _cell_faults(cell: Results, results: Results) -> Iterator[str]:
    won = cell["successes"]
    lost = sum(cell["failures"].values())
    episodes = results["episodes"]
    if min(won, *cell["failures"].values(), 0) < 0 or won + lost != episodes:
        yield f"{won} successes and {lost} failures do not make {episodes} episodes"
    elif not _same(cell["interval_95"], list(wilson_interval(won, episodes))):
        yield f"interval_95 {cell['interval_95']} is not Wilson's of {won} in {episodes}"
    force = cell["holding_force"]
    if force is not None and not (math.isfinite(force) and force >= 0.0 and (won or force == 0.0)):
        yield f"holding_force is {force} N for {won} successes"


def _same(one: Any, other: Any) -> bool:
    """Whether two results are equal up to rounding."""
    if isinstance(one, float | int) and isinstance(other, float | int):
        return math.isclose(one, other, abs_tol=1e-9)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[name], other[name]) for name in one)
    return one == other


def table(results: Results) -> str:
    """Results as a table in Markdown: a row for each split."""
    steps = "no budget named" if results["files"] else "not trained"
    steps = f"{results['budget']:,} steps, {RUNS} runs" if results["budget"] else steps
    how = f"obs {results['obs']}, {steps}, {results['episodes']:,} episodes a cell"
    left_out = lacking(results)
    partial_file = f"; **partial: without {', '.join(left_out)}**" if left_out else ""
    title = f"`{results['policy']}` in {results['env_id']}, {how}{partial_file}"
    columns = ("split", "success [%]", "runs [%]", "failures by phase [%]", "holding force [N]")
    rows = []
    for row in results["summary"]:
        # Empty for the row of all splits.
        cells = [cell for cell in results["cells"] if cell["split"] == row["split"]]
        low, high = cells[0]["interval_95"] if len(cells) == 1 else row["interval_95"]
        interval = f" [{100 * low:.1f}, {100 * high:.1f}]" if cells or results["budget"] else ""
        runs = ", ".join(f"{100 * cell['successes'] / results['episodes']:.1f}" for cell in cells)
        lost = sum((Counter(cell["failures"]) for cell in cells), Counter())
        lost.pop(NO_PHASE, None)
        why = ", ".join(
            f"{name} {100 * n / results['episodes'] / len(cells):.1f}"
            for name, n in lost.most_common()
        )
        forces = [cell["holding_force"] for cell in cells if cell["holding_force"] is not None]
        force = f"{np.mean(forces):.1f}" if forces else ""
        rows.append((row["split"], f"{100 * row['iqm']:.1f}{interval}", runs, why, force))
    return f"{title}\n\n{markdown(columns, rows)}"


def comparison(first: Results, second: Results) -> str:
    """Probability that a run of the first scores higher than a run of the second, averaged over
    splits that both have.
    """
    splits = [split for split in judged_splits(first) if split in judged_splits(second)]
    tables = _scores(first, splits), _scores(second, splits)
    value = float(probability_of_improvement(*tables))
    low, high = stratified_bootstrap(probability_of_improvement, *tables)
    return f"Probability that `{first['policy']}` does better than `{second['policy']}`: {value:.2f} [{low:.2f}, {high:.2f}]"


def read(path: Path) -> Results:
    """Read a results file.

    Raises:
        ResultsError: The file cannot be read, or is not a results file.
    """
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ResultsError(f"cannot read results file '{path}': {error}") from None
    if not isinstance(results, dict):
        raise ResultsError(f"'{path}' is not a results file: it contains no JSON object")
    return results


def check(paths: Sequence[Path], as_json: bool = False) -> int:
    """Print the faults of results files, or their tables, or both as one JSON object; returns the
    exit status, 1 if there are faults.
    """
    files = [read(path) for path in paths]
    found = [list(faults(results)) for results in files]
    rows = list(zip(map(str, paths), found, files, strict=True))
    if as_json:
        told = [
            {"path": path, "faults": bad, "summary": results.get("summary")}
            for path, bad, results in rows
        ]
        print(json.dumps({"files": told}))
        return int(any(found))
    for path, bad, results in rows:
        told = "\n".join(f"{path}: {fault}" for fault in bad)
        print(told or f"{path}: valid\n\n{table(results)}\n")
    if not any(found) and len(files) == 2 and files[0]["env_id"] == files[1]["env_id"]:
        print(comparison(*files))
    return int(any(found))


def judge_all(args: argparse.Namespace) -> Results:
    """Evaluate every cell that the file does not contain yet, and write the file after each."""
    head = header(args)
    for fault in _over_budget(head):
        print(f"no submission: {fault} (--budget names a larger one)", file=sys.stderr)
    results = read(args.out) if args.out.exists() else head | {"cells": []}
    if results.get("env_id") == head["env_id"] and _early(results):
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
        bad = next(_faults_of_cells(results, done, set(wanted)), None)
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
        "command": f"hpac benchmark {' '.join(sys.argv[2:])}",
        "summary": summary(results),
    }
    write_text(args.out, json.dumps(results, indent=1) + "\n")
    return results


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac benchmark`."""
    parser.formatter_class = Formatter
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
        help="first and last seed of the training episodes",
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
    if args.check:
        return check(args.check, args.json)
    if not (args.env and args.policy and args.out):
        raise ResultsError("an environment, --policy and --out are needed, or --check")
    results = judge_all(args)
    print(json.dumps(results) if args.json else table(results))
    return 0
