"""Optimise a grasp type: ``python -m tools.grasp_search NAME`` varies posture, object position and
wrist rotation.

An evolution strategy: each generation samples candidates around a mean, runs each in the given
engines, on seeds that no later evaluation uses, with the nominal hand and with
``randomize="hand"``, and moves the mean towards the best quarter. ``--write`` writes the result to
the data of posture and type; ``python -m tools.grasp_types`` evaluates it on other seeds."""

import argparse
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.envs.randomization import PRESETS
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, Array, joints_from_synergy
from hpac_gym.output import write_text
from hpac_gym.physics.simulation import SET_UPS
from hpac_gym.tasks.grasp_rules import GRASP_TYPES, GraspType
from tools.type_trials import TypeTrial, run_types

ROOT = Path(__file__).parents[1] / "hpac_gym"
POSTURES_FILE = ROOT / "model/data/postures.toml"
TYPES_FILE = ROOT / "tasks/data/grasp_types.toml"
SEARCH_SEED = 5_000_000
"""First seed of the search; evaluations start at 1,000,000 and stay far below."""
SPREAD = np.array([0.15] * 6 + [0.10] * 6 + [0.005] * 3 + [0.10] * 3)
"""Initial standard deviations of closed synergy and preshape [rad], position [m], and rotation
[rad].
"""
SHRINK = 0.9
ELITE = 4
"""One in this many candidates is kept."""


def candidate(kind: GraspType, numbers: Array) -> GraspType:
    """The type with other values in its data.

    Args:
        kind: the type.
        numbers: closed synergy (6,), preshape (6,) [rad], position (3,) [m], rotation vector of the
            wrist (3,) [rad].
    """
    closed, preshape = (
        np.clip(part, HPAC.synergy_min, HPAC.synergy_max).round(3)
        for part in np.split(numbers[:12], 2)
    )
    turn = Rotation.from_euler("xyz", kind.start.hand_rpy) * Rotation.from_rotvec(numbers[15:])
    position = numbers[12:15].round(4).tolist()
    rpy = np.radians(np.degrees(turn.as_euler("xyz")).round(1)).tolist()
    start = replace(
        kind.start, closed=closed, preshape=preshape, position=tuple(position), hand_rpy=tuple(rpy)
    )
    return replace(kind, start=start)


def score(trial: TypeTrial) -> float:
    """Score of an episode, 0 to about 5, graded also for failures so that the search has a
    gradient.
    """
    kept = [*trial.clauses.values(), 1.0]
    return (
        2.0 * trial.success
        + 0.5 * trial.held
        + trial.share
        + float(np.mean(kept))
        + min(kept)
        - 2.0 * (not trial.free)
    )


def elite(points: Array, drawn: Array) -> tuple[Array, Array]:
    """Indices of the best of the drawn candidates, best first, and their mean, weighted by rank."""
    best = np.argsort(-points)[: len(drawn) // ELITE]
    weights = np.linspace(1.0, 0.3, len(best))
    return best, weights @ drawn[best] / weights.sum()


def search(options: argparse.Namespace) -> GraspType:
    """Run the search with the options of `main` and return the resulting type."""
    population = options.population
    engines = options.engines
    kind = GRASP_TYPES[options.name]
    rng = np.random.default_rng(options.seed)
    mean = np.concatenate(
        [kind.start.closed, kind.start.preshape, kind.start.position, np.zeros(3)]
    )
    sigma = options.spread * SPREAD
    for generation in range(options.generations):
        drawn = mean + sigma * rng.standard_normal((population, len(mean)))
        drawn[0] = mean
        points = np.zeros(population)
        wins = np.zeros(population)
        spoiled = 0
        for number, engine in enumerate(engines):
            engine, body, randomize = engine.split("/")
            seeds = [SEARCH_SEED + 100 * generation + number] * population
            types = [candidate(kind, numbers) for numbers in drawn]
            for index, trial in run_types(
                types, seeds, engine=engine, body=body, randomize=randomize
            ):
                points[index] += score(trial) / len(engines)
                wins[index] += trial.success
                spoiled += not trial.free
        best, mean = elite(points, drawn)
        sigma *= SHRINK
        print(
            f"{options.name} {generation + 1}/{options.generations}: best {points[best[0]]:.2f}, mean {points[0]:.2f}, successes "
            f"{wins[0]:.0f} and {wins[best[0]]:.0f} of {len(engines)}, elite {wins[best].sum():.0f} of "
            f"{len(engines) * len(best)}, {spoiled} start in touch",
            file=sys.stderr,
            flush=True,
        )
    return candidate(kind, mean)


def write(grasp_type: GraspType) -> None:
    """Write the result to the data of the posture and the type."""
    start = grasp_type.start
    joints = np.minimum(
        joints_from_synergy(start.closed).round(3), np.floor(1e3 * HPAC.joint_max) / 1e3
    )
    targets = {
        digit: [joints[JOINT_INDEX[name]] for name in JOINTS if name.startswith(digit)]
        for digit in HPAC.digits
    }
    replace_values(POSTURES_FILE, start.name, targets)
    replace_values(
        TYPES_FILE,
        start.name,
        {
            "hand_rpy_deg": np.degrees(start.hand_rpy).round(1).tolist(),
            "position": list(start.position),
            "preshape": start.preshape.tolist(),
        },
    )


def replace_values(path: Path, table: str, values: dict[str, list[float]]) -> None:
    before, head, rest = path.read_text(encoding="utf-8").partition(f"[{table}]\n")
    body, *after = re.split(r"(?m)^(?=\[)", rest, maxsplit=1)
    for key, value in values.items():
        text = ", ".join(f"{number:g}" for number in value)
        body, count = re.subn(rf"(?m)^{key} = \[[^\]]*\]", f"{key} = [{text}]", body)
        if count != 1:
            raise ValueError(f"{path}: [{table}] has {key} {count} times")
    write_text(path, before + head + body + "".join(after))


def main(argv: list[str] | None = None) -> None:
    """Search one type, and print or write the result."""
    parser = command_parser("tools.grasp_search", __doc__)
    parser.add_argument("name", choices=list(GRASP_TYPES), metavar="NAME")
    add_counts(
        parser,
        generations=(1, 12, "generations of the search"),
        population=(ELITE, 24, "candidates of a generation"),
        seed=(0, 0, "of the search"),
    )
    parser.add_argument(
        "--engines",
        nargs="+",
        choices=[f"{set_up}/{ranges}" for set_up in SET_UPS for ranges in PRESETS],
        metavar="ENGINE/BODY/RANDOMIZE",
        default=["mujoco/twin/nominal", "mujoco/light/hand", "pybullet/twin/hand"],
        help="with one episode per candidate each",
    )
    parser.add_argument(
        "--spread", type=float, default=1.0, help="factor of the initial standard deviations"
    )
    parser.add_argument("--write", action="store_true", help="write the result to the data")
    options = parser.parse_args(argv)
    grasp_type = search(options)
    start = grasp_type.start
    print(
        f"closed = {start.closed.tolist()}\npreshape = {start.preshape.tolist()}\nposition = {list(start.position)}"
    )
    print(f"hand_rpy_deg = {np.degrees(start.hand_rpy).round(1).tolist()}")
    if options.write:
        write(grasp_type)


if __name__ == "__main__":
    sys.exit(run(main))
