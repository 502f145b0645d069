"""``python -m hpac_gym.bench``: what the library costs on this machine, each figure beside a bare one of the same run.

A section is a function that measures and returns its text and its figures; ``SECTIONS`` lists them by name.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import numpy as np

from hpac_gym.model import HPAC, joints_from_synergy, servo_from_action, servo_from_joints

BATCH = 100_000
ROUNDS = 9


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure, and the same of a bare counterpart."""

    name: str
    value: float
    unit: str
    bare: float
    """The counterpart without checks and names, in the same unit and the same run."""
    ratio: float
    """Cost of the figure over the cost of its counterpart: above 1 is slower."""


def seconds_per_call(call: Callable[[], object], calls: int, rounds: int = ROUNDS) -> float:
    """Time of one call, best round of several: what the machine's other work did not disturb [s]."""
    best = float("inf")
    for _ in range(rounds):
        start = perf_counter()
        for _ in range(calls):
            call()
        best = min(best, perf_counter() - start)
    return best / calls


def bare_servo_from_joints(joint_pos: np.ndarray) -> np.ndarray:
    """Eq. (15) as one vectorised map: no checks, no limits."""
    synergy = joint_pos @ HPAC.synergy_projection.T
    chord = np.sqrt(HPAC.guide_sum - HPAC.guide_product * np.cos(HPAC.guide_alpha - synergy[..., :5]))
    synergy[..., :5] = (HPAC.rest_chord - chord) / HPAC.servo_radius
    return synergy


def bare_servo_from_action(action: np.ndarray) -> np.ndarray:
    """An action's posture and Eq. (15), no checks, no limits."""
    synergy = HPAC.synergy_min + 0.5 * (action + 1) * (HPAC.synergy_max - HPAC.synergy_min)
    return bare_servo_from_joints(synergy[..., HPAC.servo_of_joint] * HPAC.elastic_ratio)


def model_rows() -> list[Row]:
    """One command with all its checks, and a batch of postures on one core."""
    rng = np.random.default_rng(0)
    action = rng.uniform(-1, 1, 6)
    one = 1e6 * seconds_per_call(lambda: servo_from_action(action), 2000)
    bare_one = 1e6 * seconds_per_call(lambda: bare_servo_from_action(action), 2000)
    posture = joints_from_synergy(rng.uniform(HPAC.synergy_min, HPAC.synergy_max, (BATCH, 6)))
    rate = BATCH / seconds_per_call(lambda: servo_from_joints(posture), 1) / 1e6
    bare_rate = BATCH / seconds_per_call(lambda: bare_servo_from_joints(posture), 1) / 1e6
    return [
        Row("servo_from_action, one command", one, "µs", bare_one, one / bare_one),
        Row(f"servo_from_joints, {BATCH:,} postures", rate, "million/s", bare_rate, bare_rate / rate),
    ]


@dataclass(frozen=True, slots=True)
class Measured:
    """What a section found."""

    lines: list[str]
    """For a reader."""
    figures: Any
    """For ``--json``."""


def model_section() -> Measured:
    """The model's rows."""
    rows = model_rows()
    lines = [f"  {row.name:<40} {row.value:8.1f} {row.unit:<10} bare {row.bare:6.1f}   × {row.ratio:.1f}" for row in rows]
    return Measured(lines, [asdict(row) for row in rows])


def env_section() -> Measured:
    """The environments' report."""
    from hpac_gym.env_bench import report  # here, so that the model can be measured without PyBullet

    found = report()
    return Measured(found.lines(), found.as_json())


SECTIONS: dict[str, Callable[[], Measured]] = {"model": model_section, "env": env_section}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--section", action="append", choices=SECTIONS, help="measure only this; may be given again")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Run the sections that are asked for and print them."""
    measured = {name: SECTIONS[name]() for name in arguments.section or SECTIONS}
    if arguments.json:
        print(json.dumps({name: section.figures for name, section in measured.items()}, indent=2))
        return 0
    for name, section in measured.items():
        print("\n".join([name, *section.lines]))
    return 0


def main(argv: Sequence[str] | None = None) -> int:
    """``python -m hpac_gym.bench``; ``hpac bench`` is the same command."""
    parser = argparse.ArgumentParser(prog="python -m hpac_gym.bench", description=__doc__.splitlines()[0])
    add_arguments(parser)
    return run(parser.parse_args(argv))


if __name__ == "__main__":
    raise SystemExit(main())
