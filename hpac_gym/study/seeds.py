"""Share of reference sweeps that show the paper's printed figures, for other tolerance draws and speeds."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping

import numpy as np

from hpac_gym.model import SERVOS
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import ALL_BELOW_DEG, EVALUATED, PRINTED, Accuracy, accuracy, met, residuals
from hpac_gym.study.processing import points, processed
from hpac_gym.study.reference import load_reference
from hpac_gym.study.results import Column, Part, Range, range_of, rows_of, table

SPEEDS = {0.75: 1.0, 1.5: 1.0, 3.0: 0.5, 6.0: 0.2}
"""Seconds per point, and the share of the seeds swept at that speed: fewer for slow sweeps. The reference file has 1.5 s."""



def accuracy_of_seed(reference_file: str | os.PathLike[str], seed: int, seconds_per_point: float) -> Accuracy:
    """Errors of a sweep of five digits; the seed determines the hand's tolerances and the camera's noise."""
    reference = load_reference(reference_file, seed=seed)
    hold = min(reference.rig.protocol.hold, seconds_per_point / 2)
    rig = reference.rig.with_protocol(seconds_per_point=seconds_per_point, hold=hold)
    sweep = rig.sweep(np.random.default_rng([seed, 1]), servos=SERVOS[:-1])
    return accuracy(residuals(points(processed(sweep, reference.cutoff_hz))))


def _index_dip(kind: str) -> Callable[[list[Accuracy]], Range]:
    return lambda runs: range_of([run.mae_deg[kind]["index_dip"] for run in runs])


def _worst(run: Accuracy) -> float:
    return max(run.mae_deg["compensated"][name] for name in EVALUATED)


COLUMNS = (
    Column("seeds", "seeds", len),
    Column("uncompensated", "index DIP without [°]", _index_dip("uncompensated")),
    Column("compensated", "with", _index_dip("compensated")),
    Column("worst_joint", "worst of nine", lambda runs: range_of([_worst(run) for run in runs])),
    Column("met", f"nine below {ALL_BELOW_DEG}°",
           lambda runs: f"{sum(met(run)[PRINTED[3]] for run in runs)} of {len(runs)}"),
    Column("all_met", "all five printed", lambda runs: f"{sum(all(met(run).values()) for run in runs)} of {len(runs)}"),
)  # fmt: skip


def seeds(reference_file: str | os.PathLike[str], count: int, speeds: Mapping[float, float]) -> Part:
    """Sweep seeds 0 … count − 1 of a reference file; `speeds` is the share of them by seconds per point."""
    jobs = [(seed, seconds) for seconds, share in speeds.items() for seed in range(max(round(share * count), 1))]
    found = [(seconds, accuracy_of_seed(reference_file, seed, seconds)) for seed, seconds in progress(jobs, "seeds and speeds")]
    runs = {f"{speed:g}": [run for seconds, run in found if seconds == speed] for speed in sorted(speeds)}
    title = "## The reference sweep, other seeds and speeds; median and the middle 95 % of the seeds"
    return Part(f"{title}\n\n{table('seconds a point', COLUMNS, rows_of(COLUMNS, runs))}\n", runs)
