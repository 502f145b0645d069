"""Speed of the model and of the command line: ``python -m tools.bench``. ``python -m
tools.env_bench`` measures the environments.

Every figure is compared with a bare one of the same run: the same map without checks and names, or
an interpreter's own start."""

import resource
import subprocess
import sys
import timeit
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hpac_gym.model import HPAC, joints_from_synergy, servo_from_action, servo_from_joints

BATCH = 100_000
ROUNDS = 9


@dataclass(frozen=True, slots=True)
class Row:
    """One measured figure, and that of a bare counterpart."""

    name: str
    value: float
    unit: str
    bare: float
    """The counterpart, in the same unit and the same run."""
    ratio: float
    """Cost of the figure over the cost of its counterpart: above 1 is slower."""


def seconds_per_call(call: Callable[[], object], calls: int) -> float:
    """Time of one call in the best of several rounds, the one least disturbed by other load [s]."""
    return min(timeit.repeat(call, repeat=ROUNDS, number=calls)) / calls


def bare_servo_from_joints(joint_pos: np.ndarray) -> np.ndarray:
    """Eq. (15) as one vectorised map without checks and limits."""
    synergy = joint_pos @ HPAC.synergy_projection.T
    chord = np.sqrt(
        HPAC.guide_sum - HPAC.guide_product * np.cos(HPAC.guide_alpha - synergy[..., :5])
    )
    synergy[..., :5] = (HPAC.rest_chord - chord) / HPAC.servo_radius
    return synergy


def bare_servo_from_action(action: np.ndarray) -> np.ndarray:
    """Posture of an action and Eq. (15), without checks and limits."""
    synergy = HPAC.synergy_min + 0.5 * (action + 1) * (HPAC.synergy_max - HPAC.synergy_min)
    return bare_servo_from_joints(synergy[..., HPAC.servo_of_joint] * HPAC.elastic_ratio)


def model_rows() -> list[Row]:
    """Time one command with all its checks, and a batch of postures on one core."""
    rng = np.random.default_rng(0)
    action = rng.uniform(-1, 1, 6)
    one = 1e6 * seconds_per_call(lambda: servo_from_action(action), 2000)
    bare_one = 1e6 * seconds_per_call(lambda: bare_servo_from_action(action), 2000)
    posture = joints_from_synergy(rng.uniform(HPAC.synergy_min, HPAC.synergy_max, (BATCH, 6)))
    rate = BATCH / seconds_per_call(lambda: servo_from_joints(posture), 1) / 1e6
    bare_rate = BATCH / seconds_per_call(lambda: bare_servo_from_joints(posture), 1) / 1e6
    return [
        Row("servo_from_action, one command", one, "µs", bare_one, one / bare_one),
        Row(
            f"servo_from_joints, {BATCH:,} postures", rate, "million/s", bare_rate, bare_rate / rate
        ),
    ]


def cpu_seconds(*words: str) -> float:
    """CPU time of a run of this Python with the given arguments, best of several [s]."""
    best = float("inf")
    for _ in range(ROUNDS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        best = min(best, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return best


def start_row() -> Row:
    """Time the list of commands, compared with an idle interpreter."""
    start = 1e3 * cpu_seconds("-m", "hpac", "--help")
    bare = 1e3 * cpu_seconds("-c", "pass")
    return Row("hpac --help", start, "ms", bare, start / bare)


def main() -> None:
    """Measure and print."""
    for row in (*model_rows(), start_row()):
        print(
            f"{row.name:<40} {row.value:8.1f} {row.unit:<10} bare {row.bare:6.1f}   × {row.ratio:.1f}"
        )


if __name__ == "__main__":
    main()
