"""How often the reference sweep shows the paper's printed figures: other draws of the same tolerances, other sweep speeds."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpac_gym.model import SERVOS
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import EVALUATED, PRINTED, accuracy, met, residuals
from hpac_gym.study.population import Range, range_of
from hpac_gym.study.processing import points, processed
from hpac_gym.study.reference import load_reference

SPEEDS = {0.75: 1.0, 1.5: 1.0, 3.0: 0.5, 6.0: 0.2}
"""Seconds per point, and what share of the seeds is swept so: a slow sweep takes long. The reference file's is 1.5 s."""


@dataclass(frozen=True, slots=True)
class SeedRun:
    """One simulated sweep: the seed draws the hand's tolerances and the camera's noise."""

    seed: int
    seconds_per_point: float
    index_dip: tuple[float, float]
    """Mean absolute error without and with compensation [°]."""
    worst_joint: float
    """Compensated, of the nine [°]."""
    met: dict[str, bool]
    """By `PRINTED` figure."""


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


def run_seeds(
    reference_file: str | os.PathLike[str],
    count: int,
    speeds: Mapping[float, float] = SPEEDS,
    shown: bool = False,
) -> list[SeedRun]:
    """Seeds 0 … count − 1 at every speed, of a slow one the first of them."""
    jobs = [(seed, seconds) for seconds, share in speeds.items() for seed in range(max(round(share * count), 1))]
    return [run_seed(reference_file, seed, seconds) for seed, seconds in progress(jobs, "seeds and speeds", shown)]


@dataclass(frozen=True, slots=True)
class SpeedRow:
    """All seeds at one speed."""

    uncompensated: Range
    compensated: Range
    """Of the index DIP [°]."""
    worst_joint: Range
    met: dict[str, int]
    """Seeds that show each `PRINTED` figure."""
    all_met: int
    seeds: int


def by_speed(runs: list[SeedRun]) -> dict[float, SpeedRow]:
    """The runs of each speed [s per point] in one row."""
    table = {}
    for seconds in sorted({run.seconds_per_point for run in runs}):
        mine = [run for run in runs if run.seconds_per_point == seconds]
        before, after = np.array([run.index_dip for run in mine]).T
        table[seconds] = SpeedRow(
            range_of(before),
            range_of(after),
            range_of(np.array([run.worst_joint for run in mine])),
            {name: sum(run.met[name] for run in mine) for name in PRINTED},
            sum(all(run.met.values()) for run in mine),
            len(mine),
        )
    return table
