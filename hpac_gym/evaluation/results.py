"""Results files of the benchmark: what they contain, their faults, their tables, and which of two is
better.
"""

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.evaluation.evaluate import NO_PHASE
from hpac_gym.evaluation.seeds import BENCHMARK_SEED, HELD_OUT_SEED
from hpac_gym.evaluation.splits import (
    BUDGETS,
    EPISODES,
    RUNS,
    SCHEMA,
    Results,
    ResultsError,
    env_hash,
    from_before,
    judged_splits,
    lacking,
    splits_of,
)
from hpac_gym.evaluation.statistics import (
    bootstrap_interval,
    interquartile_mean,
    probability_of_improvement,
    wilson_interval,
)
from hpac_gym.output import markdown


def read(path: Path) -> Results:
    """Read a results file.

    Raises:
        ResultsError: The file cannot be read, or is not a results file.
    """
    try:
        results = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ResultsError(f"cannot read results file '{path}': {error.strerror}") from None
    except (ValueError, RecursionError):
        results = None
    if not isinstance(results, dict):
        raise ResultsError(f"'{path}' is not a results file: it contains no JSON object")
    return results


def summary(results: Results) -> list[Results]:
    """Interquartile mean of the success over the runs, with its bootstrap interval, for each split
    and for all splits.
    """
    scores = _scores(results)
    names = [*judged_splits(results), "all splits"]
    tables = [*np.split(scores, scores.shape[1], axis=1), scores]
    iqm = interquartile_mean
    interval = partial(bootstrap_interval, interquartile_mean)
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


def wrong_seeds(low: int, high: int) -> Iterator[str]:
    """What is wrong with the first and the last seed of training episodes."""
    if not 0 <= low <= high < HELD_OUT_SEED:
        yield f"training seeds are {low} to {high}: they must lie in 0 to {HELD_OUT_SEED - 1}, in order"


def over_budget(results: Results) -> Iterator[str]:
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
        yield from faults_of_cells(results, counted, wanted)
        if set(counted) == wanted and not _same(results["summary"], summary(results)):
            yield "summary does not follow from the cells"
    except KeyError as error:
        yield f"field {error} is missing"
    except (TypeError, ValueError, AttributeError, ArithmeticError) as error:
        yield f"a field has a wrong value: {error}"


def _header_faults(results: Results) -> Iterator[str]:
    first = results["first_seed"]
    episodes = results["episodes"]
    budget = results["budget"]
    here = env_hash(results["env_id"])
    if results["env_sha256"] != here and not from_before(results):
        yield f"env_sha256 {results['env_sha256'][:12]}… is not that of this version of {results['env_id']}, {here[:12]}…"
    if budget not in BUDGETS:
        yield f"budget is {budget}: it must be one of {', '.join(f'{budget:,}' for budget in BUDGETS)} steps"
    if results["seeds"] != list(range(RUNS if budget else 1)):
        yield f"seeds are {results['seeds']}: a trained policy has {RUNS} from 0 on, an untrained one only 0"
    if episodes < EPISODES:
        yield f"episodes are {episodes}: a submission has at least {EPISODES:,} in each cell"
    if first != BENCHMARK_SEED:
        yield f"first_seed is {first}, not {BENCHMARK_SEED}"
    splits = splits_of(results["env_id"])
    for split in results.get("left_out", []):
        if split not in splits:
            yield f"left_out names '{split}', which is no split"
        elif splits[split].get("engine") != "pybullet":
            yield f"split '{split}' is left out: only those of PyBullet may be"
    if budget:
        yield from wrong_seeds(*results["training_seeds"])
    yield from over_budget(results)
    files = [file["sha256"] for file in results["files"]]
    runs = len(results["seeds"])
    if len(set(files)) != len(files) or len(files) not in (0, runs):
        yield f"files are {len(files)}: each of {runs} runs has its own, or none has one"
    yield from (
        f"field '{name}' is missing"
        for name in ("policy", "about", "obs", "command")
        if name not in results
    )
    missing = {"hpac_gym", "python", "mujoco-core"} - results["versions"].keys()
    yield from (f"version of {name} is missing" for name in sorted(missing))


def faults_of_cells(results: Results, counted: Counter[tuple], wanted: Set[tuple]) -> Iterator[str]:
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
    episodes = results["episodes"]
    for cell in results["cells"]:
        where = f"split '{cell['split']}' of seed {cell['seed']}"
        won = cell["successes"]
        lost = sum(cell["failures"].values())
        if min(won, *cell["failures"].values(), 0) < 0 or won + lost != episodes:
            yield f"{where}: {won} successes and {lost} failures do not make {episodes} episodes"
        elif not _same(cell["interval_95"], list(wilson_interval(won, episodes))):
            interval = cell["interval_95"]
            yield f"{where}: interval_95 {interval} is not Wilson's of {won} in {episodes}"
        force = cell["holding_force"]
        if force is not None and not (0.0 <= force < math.inf and (won or force == 0.0)):
            yield f"{where}: holding_force is {force} N for {won} successes"


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
    splits that both have, with its interval, which one run of each has not.
    """
    splits = [split for split in judged_splits(first) if split in judged_splits(second)]
    tables = _scores(first, splits), _scores(second, splits)
    value = float(probability_of_improvement(*tables))
    told = (
        f"Probability that `{first['policy']}` does better than `{second['policy']}`: {value:.2f}"
    )
    if first["budget"] or second["budget"]:
        low, high = bootstrap_interval(probability_of_improvement, *tables)
        told += f" [{low:.2f}, {high:.2f}]"
    return told
