"""Optimise the closed posture of named grasps: ``python -m tools.closure_search press tape_roll``.

An evolution strategy on both engines, on seeds that no evaluation uses; the environment stays as it
is. ``--write`` writes the result to the grasp's data; ``hpac grasps --policy scripted`` evaluates
it on other seeds."""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.evaluation.episodes import run_episodes, worlds
from hpac_gym.model import HPAC, SERVOS, Array
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.policies.baselines import ScriptedPolicy
from hpac_gym.registration import GRASP
from hpac_gym.tasks.grasp_data import GRASPS
from hpac_gym.tasks.scripted import ScriptedClosure
from tools.grasp_search import ROOT, SEARCH_SEED, elite, replace_values

GRASPS_FILE = ROOT / "tasks/data/grasps.toml"
EPISODES = {"mujoco": 8, "pybullet": 1}
"""Episodes of each candidate in a generation."""
SPREAD = 0.15
"""Initial standard deviation [rad]."""
NARROWEST = 0.01
SHRINK = 0.92
SHARE = 0.01
"""Score of a control step survived; a success scores 1."""


def scores(name: str, closed: Sequence[Array], engine: str, seeds: Sequence[int]) -> Array:
    """Mean score of each closed posture, shape (6,) [rad], over the same episodes."""
    found = []
    with worlds(GRASP, {"grasp": name, "engine": engine}, len(seeds)) as (env, envs):
        for posture in closed:
            script = ScriptedClosure(replace(GRASPS[name], closed=posture))
            policies = [ScriptedPolicy(env, script)] * envs.num_envs
            ends = [step for step in run_episodes(envs, policies, seeds) if step.over]
            found.append(np.mean([step.success + SHARE * step.number for step in ends]))
    return np.array(found)


def search(name: str, generations: int, population: int, seed: int) -> Array:
    """The closed posture found for a grasp, shape (6,) [rad]."""
    rng = np.random.default_rng(seed)
    mean = GRASPS[name].closed
    sigma = np.full(len(SERVOS), SPREAD)
    for generation in range(generations):
        drawn = mean + sigma * rng.standard_normal((population, len(mean)))
        drawn[0] = mean
        drawn = np.clip(drawn, HPAC.synergy_min, HPAC.synergy_max).round(2)
        first = SEARCH_SEED + 1000 * generation
        points = sum(
            scores(name, drawn, engine, range(first, first + EPISODES[engine]))
            for engine in ENGINES
        )
        best, mean = elite(points, drawn)
        sigma = (SHRINK * sigma + np.maximum(drawn[best].std(axis=0), NARROWEST)) / 2
        print(
            f"{name} {generation + 1}/{generations}: best {points[best[0]]:.2f}, mean {points[0]:.2f}",
            file=sys.stderr,
            flush=True,
        )
    return mean.round(2)


def main(argv: list[str] | None = None) -> None:
    """Search grasps, and print or write the results."""
    parser = command_parser("tools.closure_search", __doc__)
    parser.add_argument("names", choices=list(GRASPS), nargs="+", metavar="NAME")
    add_counts(
        parser,
        generations=(1, 16, "generations of the search"),
        population=(4, 32, "candidates of a generation"),
        seed=(0, 0, "of the search"),
    )
    parser.add_argument("--write", action="store_true", help="write the results to the data")
    options = parser.parse_args(argv)
    for name in options.names:
        closed = search(name, options.generations, options.population, options.seed).tolist()
        print(f"{name}: closed = {closed}", flush=True)
        if options.write:
            replace_values(GRASPS_FILE, name, {"closed": closed})


if __name__ == "__main__":
    sys.exit(run(main))
