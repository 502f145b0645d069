"""Share of reference sweeps that reproduce the paper's printed figures, for other tolerance draws and speeds."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpac_gym.model import SERVOS
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import ALL_BELOW_DEG, EVALUATED, PRINTED, accuracy, met, residuals
from hpac_gym.study.processing import points, processed
from hpac_gym.study.reference import load_reference
from hpac_gym.study.results import Column, Part, range_of, rows_of, table

SPEEDS = {0.75: 1.0, 1.5: 1.0, 3.0: 0.5, 6.0: 0.2}
"""Seconds per point, and the share of the seeds swept at that speed: fewer for slow sweeps. The reference file has 1.5 s."""


@dataclass(frozen=True, slots=True)
class SeedRun:
    """Result of one simulated sweep; the seed determines the hand's tolerances and the camera's noise."""

    seed: int
    seconds_per_point: float
    index_dip: tuple[float, float]
    """Mean absolute error without and with compensation [°]."""
    worst_joint: float
    """Largest compensated error of the nine joints [°]."""
    met: dict[str, bool]
    """Whether each of the `PRINTED` figures is reproduced."""


def run_seed(reference_file: str | os.PathLike[str], seed: int, seconds_per_point: float) -> SeedRun:
    """Build the reference hand of a seed and sweep its five digits."""
    reference = load_reference(reference_file, seed=seed)
    hold = min(reference.rig.protocol.hold, seconds_per_point / 2)
    rig = reference.rig.with_protocol(seconds_per_point=seconds_per_point, hold=hold)
    sweep = rig.sweep(np.random.default_rng([seed, 1]), servos=SERVOS[:-1])
    errors = accuracy(residuals(points(processed(sweep, reference.cutoff_hz))))
    before, after = errors.mae_deg["uncompensated"], errors.mae_deg["compensated"]
    return SeedRun(
        seed, seconds_per_point, (before["index_dip"], after["index_dip"]), max(after[name] for name in EVALUATED), met(errors)
    )


def _of_all(count: int, runs: list[SeedRun]) -> str:
    return f"{count} of {len(runs)}"


COLUMNS = (
    Column("seeds", "seeds", len),
    Column("uncompensated", "index DIP without [°]", lambda runs: range_of([run.index_dip[0] for run in runs])),
    Column("compensated", "with", lambda runs: range_of([run.index_dip[1] for run in runs])),
    Column("worst_joint", "worst of nine", lambda runs: range_of([run.worst_joint for run in runs])),
    Column("met", f"nine below {ALL_BELOW_DEG}°", lambda runs: _of_all(sum(run.met[PRINTED[3]] for run in runs), runs)),
    Column("all_met", "all five printed", lambda runs: _of_all(sum(all(run.met.values()) for run in runs), runs)),
)


def seeds(reference_file: str | os.PathLike[str], count: int, speeds: Mapping[float, float]) -> Part:
    """Sweep seeds 0 … count − 1 at every speed, or the first of them at slow speeds.

    Args:
        reference_file: file of the tolerances and the camera.
        count: number of seeds.
        speeds: share of the seeds by seconds per point.
    """
    jobs = [(seed, seconds) for seconds, share in speeds.items() for seed in range(max(round(share * count), 1))]
    runs = [run_seed(reference_file, seed, seconds) for seed, seconds in progress(jobs, "seeds and speeds")]
    rows = {f"{speed:g}": [run for run in runs if run.seconds_per_point == speed] for speed in sorted(speeds)}
    title = "## The reference sweep, other seeds and speeds; median and the middle 95 % of the seeds"
    return Part(f"{title}\n\n{table('seconds a point', COLUMNS, rows_of(COLUMNS, rows))}\n", runs)
