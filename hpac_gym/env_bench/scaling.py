"""Environments in several processes: beside as many processes of plain arithmetic, and as vector environments."""

from __future__ import annotations

import multiprocessing
import statistics
from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle, islice
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.env_bench.motion import Runner, actions
from hpac_gym.envs.hand_env import CONTROL_HZ
from hpac_gym.envs.phases import Timetable

ROUNDS = 3
SECONDS = 1.0
"""Length of a round [s]."""
PROCESSES = (2, 4)
NUM_ENVS = (2, 4, 8)
ENV_ID = "HPAC-Grasp-v0"


@dataclass(frozen=True, slots=True)
class Scaling:
    """Environments in processes of their own, in contact, against as many processes of plain arithmetic."""

    processes: int
    env_steps_per_second: float
    speed_up: float
    """Over one process, of environments."""
    arithmetic_speed_up: float
    """Over one process, of plain arithmetic."""
    share_of_arithmetic: float
    """The first over the second: what the environments make of the processes."""


@dataclass(frozen=True, slots=True)
class Vector:
    """A vector environment whose hands close, resets included."""

    num_envs: int
    env_steps_per_second: float
    """Of all its environments together, as `make_vec` makes them."""
    async_env_steps_per_second: float
    """The same of Gymnasium's `AsyncVectorEnv`, one process an environment."""
    ratio: float
    """Median over the rounds of the first over the second."""


def measure_scaling() -> tuple[Scaling, ...]:
    """`PROCESSES` over one."""
    counts = (1, *PROCESSES)
    rounds = [{(task, n): together(task, n) for n in counts for task in _TASKS} for _ in range(ROUNDS)]
    rate = {key: statistics.median(found[key] for found in rounds) for key in rounds[0]}
    rows = []
    for n in PROCESSES:
        env, arithmetic = (rate[task, n] / rate[task, 1] for task in ("env", "arithmetic"))
        rows.append(Scaling(n, rate["env", n], env, arithmetic, env / arithmetic))
    return tuple(rows)


def together(task: str, processes: int, seconds: float = SECONDS) -> float:
    """Work done a second by some processes at the same time."""
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(processes), context.Queue()
    workers = [context.Process(target=_work, args=(task, seconds, barrier, results)) for _ in range(processes)]
    for worker in workers:
        worker.start()
    done = sum(results.get(timeout=120) for _ in workers)
    for worker in workers:
        worker.join()
    return done


def _work(task: str, seconds: float, barrier: Any, results: Any) -> None:
    work = _TASKS[task]()
    barrier.wait()
    start, done = perf_counter(), 0
    while perf_counter() - start < seconds:
        done += work()
    results.put(done / (perf_counter() - start))


def _stepping() -> Callable[[], int]:
    runner = Runner("contact")
    runner.warm_up()

    def work() -> int:
        runner.measure(20)
        return 20

    return work


def _calculating() -> Callable[[], int]:
    def work() -> int:
        value = 1.0
        for _ in range(2000):
            value = value * 1.0000001 + 1e-9
        return 1

    return work


_TASKS = {"env": _stepping, "arithmetic": _calculating}


def measure_vectors() -> tuple[Vector, ...]:
    """`NUM_ENVS` environments, this library's way and Gymnasium's in alternating rounds."""
    rows = []
    for num_envs in NUM_ENVS:
        steppers = [VectorStepper(num_envs, mode) for mode in ("vector_entry_point", "async")]
        pairs = [[stepper.measure(SECONDS) for stepper in steppers] for _ in range(ROUNDS)]
        for stepper in steppers:
            stepper.envs.close()
        ours, its = (statistics.median(rates) for rates in zip(*pairs, strict=True))
        rows.append(Vector(num_envs, ours, its, statistics.median(one / other for one, other in pairs)))
    return tuple(rows)


class VectorStepper:
    """Closes the hands of a vector environment, episode after episode."""

    def __init__(self, num_envs: int, mode: str) -> None:
        self.envs = gymnasium.make_vec(ENV_ID, num_envs=num_envs, vectorization_mode=mode)
        self.envs.reset(seed=0)
        episode = round(Timetable().duration * CONTROL_HZ) + 1  # the step after the last begins anew
        self._closing = cycle(islice(actions("contact"), episode))

    def measure(self, seconds: float) -> float:
        """Steps a second of all environments together."""
        start, steps = perf_counter(), 0
        while perf_counter() - start < seconds:
            self.envs.step(np.tile(next(self._closing), (self.envs.num_envs, 1)).astype(np.float32))
            steps += self.envs.num_envs
        return steps / (perf_counter() - start)
