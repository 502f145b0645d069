"""The grasp benchmark: policies at the sixteen named grasps, all over the same held-out episodes."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from hpac_gym.envs import GRASPS, NOMINAL
from hpac_gym.evaluation.episode import control_steps
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.evaluation.workers import shared
from hpac_gym.policies import Policy
from hpac_gym.policies.loading import load_policy
from hpac_gym.progress import progress
from hpac_gym.tasks.grasp_data import named_grasp

TASK = "HPAC-Grasp-v0"
CHUNK = 5  # episodes that a worker does at a time
COLUMNS = ("grasp", "object", "policy", "success", "95 % interval", "hold force", "drops by phase")


@dataclass(frozen=True, slots=True)
class Trial:
    """How one episode of a grasp ended.

    Attributes:
        phase: of the wrist when it ended.
        hold_force: mean of all contact forces in the last phase [N]; None without one.
    """

    seed: int
    success: bool
    phase: str
    hold_force: float | None


@dataclass(frozen=True, slots=True)
class Row:
    """The trials of one policy at one grasp, at least one, with the object of that variant."""

    grasp: str
    policy: str
    trials: tuple[Trial, ...]
    variant: str = NOMINAL

    def summary(self) -> dict[str, Any]:
        """Success with its interval, hold force of what was held [N], and drops by phase."""
        grasp = GRASPS[self.grasp]
        wins = [trial for trial in self.trials if trial.success]
        forces = [trial.hold_force for trial in wins if trial.hold_force is not None]
        return {
            "grasp": self.grasp,
            "family": grasp.family,
            "object": (grasp.variant(self.variant).object or grasp.object).about,
            "policy": self.policy,
            "episodes": len(self.trials),
            "successes": len(wins),
            "success_rate": len(wins) / len(self.trials),
            "interval_95": list(wilson_interval(len(wins), len(self.trials))),
            "hold_force_newton": float(np.mean(forces)) if forces else None,
            "drops_by_phase": dict(Counter(trial.phase for trial in self.trials if not trial.success).most_common()),
        }


def run_trial(env: gymnasium.Env, policy: Policy, seed: int) -> Trial:
    """One episode of a grasp."""
    forces = []
    for _, info in control_steps(env, policy, seed):
        if info["phase"] == "place":
            forces.append(info["contact_force"])
    return Trial(seed, bool(info["is_success"]), info["phase"], float(np.mean(forces)) if forces else None)


def run_trials(policy: str, grasp: str, variant: str, seeds: Sequence[int]) -> list[Trial]:
    """Episodes of one policy at one grasp, in an environment of their own."""
    with gymnasium.make(TASK, grasp=grasp, variant=variant) as env:
        actor = load_policy(policy, env)
        return [run_trial(env, actor, seed) for seed in seeds]


def benchmark(
    policies: Sequence[str], grasps: Sequence[str], episodes: int,
    *, variant: str = NOMINAL, seed_start: int = HELD_OUT_SEED, workers: int = 1,
) -> list[Row]:  # fmt: skip
    """Run policies at grasps over the same held-out seeds, with a progress bar where standard error is a terminal.

    Raises:
        GraspError: No grasp or variant has that name.
        PolicyError: A policy cannot be loaded, or is of another environment.
        WorkerError: A worker process was ended from outside.
    """
    for grasp in grasps:
        named_grasp(grasp).variant(variant)
    for policy in policies:
        run_trials(policy, grasps[0], variant, ())  # a mistake ends here, not in a worker
    seeds = range(seed_start, seed_start + episodes)
    parts = [seeds[start : start + CHUNK] for start in range(0, episodes, CHUNK)]
    cells = [(policy, grasp) for grasp in grasps for policy in policies]
    jobs = [(policy, grasp, variant, part) for policy, grasp in cells for part in parts]
    found: dict[tuple[str, str], list[Trial]] = {cell: [] for cell in cells}
    shown = progress(jobs, "grasps", sys.stderr.isatty())
    for (policy, grasp, *_), trials in zip(shown, shared(run_trials, jobs, workers), strict=True):
        found[policy, grasp] += trials
    return [Row(grasp, policy, tuple(found[policy, grasp]), variant) for policy, grasp in cells]


def table(rows: Sequence[Row]) -> str:
    """The rows as a table in Markdown."""
    lines = [f"| {' | '.join(COLUMNS)} |", "| --- " * len(COLUMNS) + "|"]
    for row in rows:
        numbers = row.summary()
        low, high = numbers["interval_95"]
        force = numbers["hold_force_newton"]
        drops = ", ".join(f"{phase} {count}" for phase, count in numbers["drops_by_phase"].items()) or "–"
        lines.append(
            f"| {row.grasp} | {numbers['object']} | {row.policy} | {numbers['success_rate']:.0%} | {low:.0%} … {high:.0%} "
            f"| {'–' if force is None else f'{force:.0f} N'} | {drops} |"
        )
    return "\n".join(lines)
