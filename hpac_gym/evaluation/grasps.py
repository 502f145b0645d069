"""`hpac grasps`, the grasp benchmark: policies on the sixteen named grasps, over the same held-out
episodes.
"""

import argparse
import json
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.command import whole_number
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, worlds
from hpac_gym.evaluation.evaluate import add_seeds_and_workers, parts_of
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import markdown, writable_folder, write_text
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.policies.loading import NAMES, NORMALIZE, about, load_policy
from hpac_gym.registration import GRASP
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL, named_grasp

RANDOM = "random"
DEFAULTS = {"variant": NOMINAL, "engine": "mujoco"}
COLUMNS = ("grasp", "object", "policy", "success", "95 % interval", "hold force", "drops by phase")
_ABOUT = """\
Runs a policy and a random policy on the sixteen named grasps over the same held-out episodes. Prints a table of success
with its Wilson 95 % interval, holding force and drops by phase. Writes the table, a picture of each grasp and a contact
sheet. A picture shows the end of the first successful episode, or of the last one if none succeeded."""


@dataclass(frozen=True, slots=True)
class Trial:
    """Result of one episode of a grasp.

    Attributes:
        phase: phase of the wrist at the end.
        hold_force: mean contact force in the last phase [N]; None if the episode ended before it.
    """

    seed: int
    success: bool
    phase: str
    hold_force: float | None


@dataclass(frozen=True, slots=True)
class Row:
    """The trials (at least one) of one policy at one grasp with one object variant."""

    grasp: str
    policy: str
    trials: tuple[Trial, ...]
    variant: str = NOMINAL

    def summary(self) -> dict[str, Any]:
        """Success with its interval, holding force of the successes [N], and drops by phase."""
        grasp = GRASPS[self.grasp]
        wins = [trial for trial in self.trials if trial.success]
        forces = [trial.hold_force for trial in wins if trial.hold_force is not None]
        return {
            "grasp": self.grasp,
            "family": grasp.family,
            "object": (grasp.variant(self.variant).object or grasp.object).about,
            "policy": self.policy,
            **success_counts(len(wins), len(self.trials)),
            "hold_force_newton": float(np.mean(forces)) if forces else None,
            "drops_by_phase": dict(
                Counter(trial.phase for trial in self.trials if not trial.success).most_common()
            ),
        }


def run_trials(
    policy: str,
    grasp: str,
    options: Mapping[str, str],
    seeds: Sequence[int],
    normalize: str | None = None,
) -> list[Trial]:
    """Run episodes of one policy at one grasp in new environments with these options."""
    forces: dict[int, list[float]] = {seed: [] for seed in seeds}
    trials = {}
    with worlds(GRASP, {"grasp": grasp, **options}, len(seeds)) as (env, envs):
        policies = [load_policy(policy, env, normalize) for _ in range(envs.num_envs)]
        for step in run_episodes(envs, policies, seeds):
            info = step.info
            if step.number and info["phase"] == "place":
                forces[step.seed].append(info["contact_force"])
            if step.over:
                force = float(np.mean(forces[step.seed])) if forces[step.seed] else None
                trials[step.seed] = Trial(step.seed, step.success, str(info["phase"]), force)
    return [trials[seed] for seed in seeds]


def benchmark(
    policies: Sequence[str],
    grasps: Sequence[str],
    episodes: int,
    *,
    options: Mapping[str, str] = DEFAULTS,
    seed_start: int = HELD_OUT_SEED,
    workers: int = 1,
    normalize: str | None = None,
) -> list[Row]:
    """Run policies at grasps over the same held-out seeds, with a progress bar if standard error is
    a terminal.

    Raises:
        GraspError: A grasp or variant does not exist.
        PolicyError: A policy cannot be loaded, or was made for another environment.
        WorkerError: A worker process was ended from outside.
    """
    variant = options["variant"]
    for grasp in grasps:
        named_grasp(grasp).variant(variant)
    with make_env(GRASP, grasp=grasps[0], **options) as env:
        for policy in policies:
            load_policy(policy, env, normalize)  # errors are raised here, not in a worker
        parts = parts_of(env, range(seed_start, seed_start + episodes), workers)
    cells = [(policy, grasp) for grasp in grasps for policy in policies]
    jobs = [(policy, grasp, options, part, normalize) for policy, grasp in cells for part in parts]
    trials_of: dict[tuple[str, str], list[Trial]] = {cell: [] for cell in cells}
    done = shared(run_trials, jobs, workers, "grasps")
    for (policy, grasp, *_), trials in zip(jobs, done, strict=True):
        trials_of[policy, grasp] += trials
    return [Row(grasp, policy, tuple(trials_of[policy, grasp]), variant) for policy, grasp in cells]


def table(rows: Sequence[Row]) -> str:
    """The rows as a table in Markdown."""
    cells = []
    for row in rows:
        numbers = row.summary()
        low, high = numbers["interval_95"]
        force = numbers["hold_force_newton"]
        drops = (
            ", ".join(f"{phase} {count}" for phase, count in numbers["drops_by_phase"].items())
            or "–"
        )
        force = "–" if force is None else f"{force:.0f} N"
        rate = f"{numbers['success_rate']:.0%}", f"{low:.0%} … {high:.0%}"
        cells.append((row.grasp, numbers["object"], row.policy, *rate, force, drops))
    return markdown(COLUMNS, cells)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac grasps`."""
    parser.description = _ABOUT
    parser.add_argument(
        "--policy",
        default="scripted",
        help=NAMES,
    )
    parser.add_argument("--normalize", metavar="FILE", help=NORMALIZE)
    parser.add_argument(
        "-n",
        "--episodes",
        type=whole_number(1),
        default=50,
        metavar="N",
        help="episodes per policy and grasp (5 for a quick look)",
    )
    parser.add_argument(
        "--grasps", nargs="+", metavar="NAME", help="only these (default: all sixteen)"
    )
    parser.add_argument(
        "--variant",
        help="object variant: large, small, heavy, slippery or shape (default: nominal)",
    )
    parser.add_argument("--engine", choices=ENGINES, help="physics (default: mujoco)")
    add_seeds_and_workers(parser)
    parser.add_argument(
        "--no-baselines", action="store_true", help="do not also run the random policy"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/grasps"),
        metavar="DIR",
        help="folder for table and pictures",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of the table"
    )
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Run the command."""
    # Imported here so that the command's help needs no Pillow.
    from hpac_gym.evaluation.pictures import portrait, write_pictures

    made = {name: getattr(options, name) or value for name, value in DEFAULTS.items()}
    names = list(dict.fromkeys(options.grasps or GRASPS))
    policies = list(
        dict.fromkeys([options.policy] if options.no_baselines else [options.policy, RANDOM])
    )
    writable_folder(options.out)
    rows = benchmark(
        policies,
        names,
        options.episodes,
        options=made,
        seed_start=options.seed_start,
        workers=options.workers,
        normalize=options.normalize,
    )
    result = {
        "task": GRASP,
        **made,
        "first_seed": options.seed_start,
        "grasps": [row.summary() for row in rows],
    }
    if told := about(options.policy, options.normalize):
        result["policy"] = {"file": options.policy, **told}
    print(json.dumps(result, indent=2) if options.json else table(rows), flush=True)
    trials = {f"{row.grasp}/{row.policy}": [asdict(trial) for trial in row.trials] for row in rows}
    write_text(
        options.out / "grasps.json", json.dumps({**result, "trials": trials}, indent=2) + "\n"
    )
    write_text(options.out / "grasps.md", table(rows) + "\n")

    seeds = {
        row.grasp: next((trial.seed for trial in row.trials if trial.success), row.trials[-1].seed)
        for row in rows
        if row.policy == options.policy
    }
    jobs = [(options.policy, grasp, seed, made, options.normalize) for grasp, seed in seeds.items()]
    seen = shared(portrait, jobs, options.workers, "pictures")
    write_pictures(options.out, dict(zip(seeds, seen, strict=True)))
    print(f"written to {options.out}", file=sys.stderr)
    return 0
