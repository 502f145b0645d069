"""Speed of the model and of the command line: ``python -m tools.bench``. ``python -m
tools.env_bench`` measures the environments.

Every figure is compared with a bare one of the same run: the same map without checks and names, or
an interpreter's own start."""

import resource
import subprocess
import sys
import timeit
from collections.abc import Callable

import numpy as np

from hpac_gym.model import HPAC, joints_from_synergy, servo_from_action, servo_from_joints

BATCH = 100_000
ROUNDS = 9


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


def cost_of_a_command() -> tuple[float, float]:
    """Time of one command with all its checks, and of the bare maps [µs]."""
    action = np.random.default_rng(0).uniform(-1, 1, 6)
    return (
        1e6 * seconds_per_call(lambda: servo_from_action(action), 2000),
        1e6 * seconds_per_call(lambda: bare_servo_from_action(action), 2000),
    )


def rate_of_a_batch() -> tuple[float, float]:
    """Postures per second on one core with all checks, and by the bare map [million/s]."""
    rng = np.random.default_rng(0)
    posture = joints_from_synergy(rng.uniform(HPAC.synergy_min, HPAC.synergy_max, (BATCH, 6)))
    return (
        BATCH / seconds_per_call(lambda: servo_from_joints(posture), 1) / 1e6,
        BATCH / seconds_per_call(lambda: bare_servo_from_joints(posture), 1) / 1e6,
    )


def cpu_seconds(*words: str) -> float:
    """CPU time of a run of this Python with the given arguments, best of several [s]."""
    best = float("inf")
    for _ in range(ROUNDS):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *words], stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        best = min(best, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return best


def main() -> None:
    """Measure and print each figure, its bare counterpart, and how much slower it is."""
    command, bare_command = cost_of_a_command()
    rate, bare_rate = rate_of_a_batch()
    start = 1e3 * cpu_seconds("-m", "hpac", "--help")
    bare_start = 1e3 * cpu_seconds("-c", "pass")
    for name, value, unit, bare, slower in (
        ("servo_from_action, one command", command, "µs", bare_command, command / bare_command),
        (f"servo_from_joints, {BATCH:,} postures", rate, "million/s", bare_rate, bare_rate / rate),
        ("hpac --help", start, "ms", bare_start, start / bare_start),
    ):
        print(f"{name:<40} {value:8.1f} {unit:<10} bare {bare:6.1f}   × {slower:.1f}")


if __name__ == "__main__":
    main()
