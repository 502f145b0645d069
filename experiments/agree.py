"""`python -m experiments.agree`: the same episodes on several engines and bodies, and how often
their outcomes agree.

The floor is the best agreement that can be expected: an engine compared with itself, with the
object displaced imperceptibly. Contact amplifies every difference, so single episodes diverge long
before success rates do."""

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import eq
from typing import Any

import gymnasium
import numpy as np

from hpac_gym.body.urdf import WRIST_EFFORT
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import markdown
from hpac_gym.physics.mjcf import TORSION
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.physics.simulation import SET_UPS
from hpac_gym.registration import GRASP

FLOOR = (1e-6, 1e-3)
"""Displacements of the object along the palm's normal when an engine is compared with itself [m].
"""
CHUNK = 10
"""Episodes per job of a worker."""
VARIATIONS = {
    "iterative": WorldSettings(solver_iterations=200),
    "iterative+torsion": WorldSettings(solver_iterations=200, torsion=TORSION),
    "no-torsion": WorldSettings(torsion=0.0),
    "wrist-200-N": WorldSettings(wrist_effort=WRIST_EFFORT),
    "60-Hz": WorldSettings(physics_hz=60),
    "480-Hz": WorldSettings(physics_hz=480),
}
"""Physics that shows why the engines differ: PyBullet with its iterative solver, without and with
MuJoCo's torsional friction; MuJoCo without torsional friction, and with PyBullet's limit of the
wrist's force; either engine at another rate."""


@dataclass(frozen=True, slots=True)
class Variant:
    """One way of simulating the episodes."""

    engine: str
    body: str
    variation: str = ""
    """Name of one of `VARIATIONS`; empty for the engine's own physics."""
    moved: float = 0.0
    """Displacement of the object along the palm's normal [m]."""

    @property
    def name(self) -> str:
        return "/".join(filter(None, (self.engine, self.body, self.variation)))


@dataclass(frozen=True, slots=True)
class Trial:
    """The outcome of one episode and the shape of its object."""

    success: bool
    shape: str


def run_trials(policy: str, variant: Variant, seeds: Sequence[int], randomize: str) -> list[Trial]:
    """Episodes of one policy in one variant, in an environment of their own."""
    from hpac_gym.envs import Grasp, HandEnv
    from hpac_gym.evaluation.episodes import run_episodes, single
    from hpac_gym.physics.simulation import make_engine
    from hpac_gym.policies.loading import load_policy

    class Moved(Grasp):
        """The task of `GRASP`, with its objects displaced."""

        def setup(self, rng, hand):
            setup = super().setup(rng, hand)
            return replace(setup, position=setup.position + np.array([variant.moved, 0.0, 0.0]))

    world = VARIATIONS.get(variant.variation, WorldSettings())
    physics = make_engine(variant.engine, 1, world)
    with HandEnv(Moved(), physics=physics, body=variant.body, randomize=randomize) as env:
        env.spec = gymnasium.spec(GRASP)
        actor = load_policy(policy, env)
        trials = []
        for seed in seeds:
            *_, last = run_episodes(single(env), [actor], [seed])
            trials.append(Trial(last.success, env.episodes.setups[0].object.shape))
        return trials


def compare(first: Sequence[Trial], second: Sequence[Trial]) -> dict[str, Any]:
    """Difference of success, second minus first, over the same episodes, with a 95 % interval, and
    the share that agrees.
    """
    before, after = ([trial.success for trial in part] for part in (first, second))
    difference, low, high = paired_difference(after, before)
    return {
        "episodes": len(before),
        "difference": difference,
        "interval_95": [low, high],
        "agree": sum(map(eq, before, after)) / len(before),
    }


def agreement(
    policy: str,
    episodes: int,
    set_ups: Sequence[str] = SET_UPS,
    *,
    seed_start: int = HELD_OUT_SEED,
    randomize: str = "nominal",
    floor: bool = True,
    workers: int = 1,
) -> dict[str, Any]:
    """Run the same episodes in every set-up.

    Args:
        policy: scripted, random, or a policy file.
        episodes: number of episodes per set-up.
        set_ups: names engine/body or engine/body/variation, with one of `VARIATIONS`; each is
            compared with the first.
        seed_start: seed of the first episode.
        randomize: a preset of `hpac_gym.envs.randomization.PRESETS`.
        floor: compare every set-up also with itself.
        workers: number of processes.

    Raises:
        ParameterError: A set-up is not of that form.
        PolicyError: The policy cannot be loaded, or was made for another environment.
        WorkerError: A worker process was ended from outside.
    """
    plain = [_variant(name) for name in dict.fromkeys(set_ups)]
    moves = FLOOR if floor else ()
    variants = plain + [replace(variant, moved=moved) for variant in plain for moved in moves]
    for variant in plain:
        run_trials(policy, variant, (), randomize)  # errors are raised here, not in a worker
    seeds = range(seed_start, seed_start + episodes)
    parts = [seeds[start : start + CHUNK] for start in range(0, episodes, CHUNK)]
    jobs = [(policy, variant, part, randomize) for variant in variants for part in parts]
    found: dict[Variant, list[Trial]] = {variant: [] for variant in variants}
    done = shared(run_trials, jobs, workers, "agree")
    for (_, variant, *_), trials in zip(jobs, done, strict=True):
        found[variant] += trials
    reference = found[plain[0]]
    shapes = sorted({trial.shape for trial in reference})
    rows = []
    for variant in plain:
        trials = found[variant]
        row = {"set_up": variant.name, "success": _rate(trials)}
        row["by_shape"] = {
            shape: _rate([trial for trial in trials if trial.shape == shape]) for shape in shapes
        }
        if variant is not plain[0]:
            row["over"] = plain[0].name
            row |= compare(reference, trials)
            row["difference_by_shape"] = {
                shape: compare(_only(reference, shape), _only(trials, shape)) for shape in shapes
            }
        row["floor"] = {
            f"{1e3 * moved:g} mm": compare(trials, found[replace(variant, moved=moved)])
            for moved in moves
        }
        rows.append(row)
    about = {
        "task": GRASP,
        "policy": policy,
        "first_seed": seed_start,
        "episodes": episodes,
        "randomize": randomize,
    }
    return about | {"set_ups": rows}


def _only(trials: Sequence[Trial], shape: str) -> list[Trial]:
    return [trial for trial in trials if trial.shape == shape]


def _variant(name: str) -> Variant:
    match name.split("/"):
        case [engine, body] if engine and body:
            return Variant(engine, body)
        case [engine, body, variation] if engine and body and variation in VARIATIONS:
            return Variant(engine, body, variation)
    known = ", ".join(VARIATIONS)
    raise ParameterError(
        f"set-up {name!r} must be an engine and a body, such as mujoco/light, then perhaps one of {known}"
    )


def _rate(trials: Sequence[Trial]) -> dict[str, Any]:
    return success_counts(sum(trial.success for trial in trials), len(trials))


def table(result: dict[str, Any]) -> str:
    """The result as tables in Markdown."""
    floors = [
        f"agrees with itself, object moved by {moved}" for moved in result["set_ups"][0]["floor"]
    ]
    head = ["set-up", "success", "95 % interval", "difference", "95 % interval", "agree", *floors]
    rows = []
    by_shape = []
    for row in result["set_ups"]:
        rate = row["success"]
        (low, high) = row["success"]["interval_95"]
        cells = [row["set_up"], f"{rate['success_rate']:.1%}", f"{low:.1%} … {high:.1%}"]
        if "difference" in row:
            low, high = row["interval_95"]
            cells += [
                f"{100 * row['difference']:+.1f}",
                f"{100 * low:+.1f} … {100 * high:+.1f}",
                f"{row['agree']:.1%}",
            ]
        else:
            cells += ["–", "–", "–"]
        rows.append([*cells, *(f"{found['agree']:.1%}" for found in row["floor"].values())])
        if "difference_by_shape" in row:
            by_shape.append([row["set_up"], *map(_interval, row["difference_by_shape"].values())])
    shapes = ["difference by object", *result["set_ups"][0]["by_shape"]]
    return f"{markdown(head, rows)}\n\n{markdown(shapes, by_shape)}"


def _interval(entry: dict[str, Any]) -> str:
    low, high = entry["interval_95"]
    return f"{100 * entry['difference']:+.1f} ({100 * low:+.1f} … {100 * high:+.1f}) of {entry['episodes']}"


def main(argv: list[str] | None = None) -> int:
    """Run the command."""
    parser = command_parser("experiments.agree", __doc__)
    parser.add_argument("--policy", default="scripted", help="scripted, random, or a policy file")
    parser.add_argument(
        "-n",
        "--episodes",
        type=whole_number(1),
        default=1200,
        metavar="N",
        help="episodes per set-up",
    )
    parser.add_argument(
        "--set-ups",
        nargs="+",
        default=list(SET_UPS),
        metavar="ENGINE/BODY",
        help="set-ups, compared with the first; ENGINE/BODY/VARIATION has other "
        f"physics: {', '.join(VARIATIONS)}",
    )
    parser.add_argument(
        "--no-floor",
        dest="floor",
        action="store_false",
        help="do not compare the set-ups with themselves",
    )
    parser.add_argument("--randomize", default="nominal", help="nominal, hand, link or full")
    parser.add_argument(
        "--seed-start",
        type=whole_number(0),
        default=HELD_OUT_SEED,
        metavar="SEED",
        help="seed of the first episode",
    )
    parser.add_argument(
        "--workers",
        type=whole_number(1),
        default=os.cpu_count() or 1,
        metavar="N",
        help="number of processes",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of the tables"
    )
    arguments = parser.parse_args(argv)
    report = agreement(
        arguments.policy,
        arguments.episodes,
        arguments.set_ups,
        seed_start=arguments.seed_start,
        randomize=arguments.randomize,
        floor=arguments.floor,
        workers=arguments.workers,
    )
    print(json.dumps(report, indent=2) if arguments.json else table(report))
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
