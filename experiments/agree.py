"""`python -m experiments.agree`: the same episodes on several engines and bodies, and how often
their outcomes agree.

The floor is the best agreement that can be expected: an engine compared with itself, with the
object displaced imperceptibly. Contact amplifies every difference, so single episodes diverge long
before success rates do."""

import json
import sys
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import eq
from typing import Any

import gymnasium
import numpy as np

from hpac_gym.body.urdf import WRIST_EFFORT
from hpac_gym.command import command_parser, run, whole_number
from hpac_gym.envs import Grasp, HandEnv
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.evaluate import add_seeds_and_workers
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.evaluation.workers import shared
from hpac_gym.output import markdown
from hpac_gym.physics.mjcf import TORSION
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.physics.simulation import SET_UPS, make_engine
from hpac_gym.policies.loading import load_policy
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
class Trial:
    """The outcome of one episode and the shape of its object."""

    success: bool
    shape: str


def parsed(set_up: str) -> tuple[str, str, WorldSettings]:
    """Engine, body and physics of a set-up, engine/body or engine/body/variation.

    Raises:
        ParameterError: It is not of that form.
    """
    match set_up.split("/"):
        case [engine, body] if engine and body:
            return engine, body, WorldSettings()
        case [engine, body, variation] if engine and body and variation in VARIATIONS:
            return engine, body, VARIATIONS[variation]
    known = ", ".join(VARIATIONS)
    raise ParameterError(
        f"set-up {set_up!r} must be an engine and a body, such as mujoco/light, then perhaps one of {known}"
    )


def run_trials(
    policy: str, set_up: str, moved: float, seeds: Sequence[int], randomize: str
) -> list[Trial]:
    """Episodes of one policy in one set-up, in an environment of their own, with the object displaced
    along the palm's normal [m].
    """

    class Moved(Grasp):
        """The task of `GRASP`, with its objects displaced."""

        def setup(self, rng, hand):
            setup = super().setup(rng, hand)
            return replace(setup, position=setup.position + np.array([moved, 0.0, 0.0]))

    engine, body, world = parsed(set_up)
    physics = make_engine(engine, 1, world)
    with HandEnv(Moved(), physics=physics, body=body, randomize=randomize) as env:
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
    difference, *interval = paired_difference(after, before)
    return {
        "episodes": len(before),
        "difference": difference,
        "interval_95": interval,
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
    names = list(dict.fromkeys(set_ups))
    for name in names:
        run_trials(policy, name, 0.0, (), randomize)  # errors are raised here, not in a worker
    moves = FLOOR if floor else ()
    seeds = range(seed_start, seed_start + episodes)
    jobs = [
        (policy, name, moved, seeds[start : start + CHUNK], randomize)
        for name in names
        for moved in (0.0, *moves)
        for start in range(0, episodes, CHUNK)
    ]
    found: dict[tuple[str, float], list[Trial]] = defaultdict(list)
    done = shared(run_trials, jobs, workers, "agree")
    for (_, name, moved, *_), trials in zip(jobs, done, strict=True):
        found[name, moved] += trials
    first = names[0]
    reference = found[first, 0.0]
    shapes = sorted({trial.shape for trial in reference})
    rows = []
    for name in names:
        trials = found[name, 0.0]
        of_shape = {shape: _only(trials, shape) for shape in shapes}
        row = {"set_up": name, "success": _rate(trials)}
        row["by_shape"] = {shape: _rate(part) for shape, part in of_shape.items()}
        if name != first:
            row |= {"over": first, **compare(reference, trials)}
            row["difference_by_shape"] = {
                shape: compare(_only(reference, shape), part) for shape, part in of_shape.items()
            }
        row["floor"] = {
            f"{1e3 * moved:g} mm": compare(trials, found[name, moved]) for moved in moves
        }
        rows.append(row)
    return {
        "task": GRASP,
        "policy": policy,
        "first_seed": seed_start,
        "episodes": episodes,
        "randomize": randomize,
        "set_ups": rows,
    }


def _only(trials: Sequence[Trial], shape: str) -> list[Trial]:
    return [trial for trial in trials if trial.shape == shape]


def _rate(trials: Sequence[Trial]) -> dict[str, Any]:
    return success_counts(sum(trial.success for trial in trials), len(trials))


def table(result: dict[str, Any]) -> str:
    """The result as tables in Markdown."""
    first = result["set_ups"][0]
    floors = [f"agrees with itself, object moved by {moved}" for moved in first["floor"]]
    head = ["set-up", "success", "95 % interval", "difference", "95 % interval", "agree", *floors]
    rows = []
    by_shape = []
    for row in result["set_ups"]:
        rate = row["success"]
        low, high = rate["interval_95"]
        compared = ["–", "–", "–"]
        if row is not first:
            compared = [*_difference(row), f"{row['agree']:.1%}"]
            parts = row["difference_by_shape"].values()
            told = ["{} ({}) of {}".format(*_difference(part), part["episodes"]) for part in parts]
            by_shape.append([row["set_up"], *told])
        success = (f"{rate['success_rate']:.1%}", f"{low:.1%} … {high:.1%}")
        floor = (f"{found['agree']:.1%}" for found in row["floor"].values())
        rows.append([row["set_up"], *success, *compared, *floor])
    shapes = ["difference by object", *first["by_shape"]]
    return f"{markdown(head, rows)}\n\n{markdown(shapes, by_shape)}"


def _difference(entry: dict[str, Any]) -> tuple[str, str]:
    low, high = entry["interval_95"]
    return f"{100 * entry['difference']:+.1f}", f"{100 * low:+.1f} … {100 * high:+.1f}"


def main(argv: list[str] | None = None) -> None:
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
    add_seeds_and_workers(parser)
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


if __name__ == "__main__":
    sys.exit(run(main))
