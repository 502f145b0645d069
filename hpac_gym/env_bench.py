"""The environments' part of ``python -m hpac_gym.bench``: steps a second, resets, pictures, and scaling over processes.

Free motion is a hand that waves with the object out of reach; in contact it holds a can that it was given. Every figure is
taken at 20 commands a second. Rates are medians over rounds, so that what else the machine does weighs less.
"""

from __future__ import annotations

import json
import multiprocessing
import statistics
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any

import gymnasium
import numpy as np

from hpac_gym.envs import Grasp, HandEnv
from hpac_gym.envs.hand_env import CONTROL_HZ
from hpac_gym.sim import ObjectSpec, SceneSetup
from hpac_gym.sim.quiet import quiet_output

ROUNDS = 7
ROUND_STEPS = 60
PEER = "PandaPickAndPlace-v3"
_SYNERGY = np.array([0, 0, 0, 0, 0, 1.2])
_CAN = ObjectSpec("cylinder", (0.027, 0.027, 0.05), mass=0.15, friction=0.9)
SETUPS = {
    "free": SceneSetup(_CAN, np.array([0.25, 0.0, 0.25]), 0.0, _SYNERGY),
    "contact": SceneSetup(_CAN, np.array([0.048, 0.004, 0.112]), 0.0, _SYNERGY),
}
"""An object out of reach, and one in the hand."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What one kind of motion costs."""

    env_steps_per_second: float
    real_time_factor: float
    """Simulated seconds a second."""
    reset_ms: float
    outside_physics_share: float
    """Of a step's time, what is not in the simulator's own step."""


@dataclass(frozen=True, slots=True)
class Scaling:
    """Environments in processes of their own, against as many processes of plain arithmetic."""

    processes: int
    env_steps_per_second: float
    speed_up: float
    """Over one process, of environments."""
    arithmetic_speed_up: float
    """Over one process, of plain arithmetic."""


@dataclass(frozen=True, slots=True)
class Report:
    """All the figures of one run."""

    physics_hz: int
    control_hz: int
    free: Motion
    contact: Motion
    renders_per_second: float
    scaling: tuple[Scaling, ...]
    peer: dict[str, Any] | None
    """Steps a second of `PEER` in the same rounds, and how many times as fast this library is; None if not installed."""

    def lines(self) -> list[str]:
        """The report as text."""
        lines = [f"  physics at {self.physics_hz} Hz, {self.control_hz} commands a second"]
        for name in ("free", "contact"):
            motion: Motion = getattr(self, name)
            lines.append(
                f"  {name:<8} {motion.env_steps_per_second:7.0f} env steps/s   {motion.real_time_factor:6.1f} × real time   "
                f"reset {motion.reset_ms:5.2f} ms   outside physics {motion.outside_physics_share:5.1%}"
            )
        lines.append(f"  pictures {self.renders_per_second:7.1f} a second, 480 × 360")
        lines += [
            f"  {row.processes} processes {row.env_steps_per_second:6.0f} env steps/s   × {row.speed_up:.2f}   "
            f"plain arithmetic × {row.arithmetic_speed_up:.2f}"
            for row in self.scaling
        ]
        if self.peer is None:
            lines.append(f"  {PEER}: not installed (pip install 'hpac_gym[bench]')")
        else:
            ratio = self.peer["ratio"]
            lines.append(
                f"  {PEER} {self.peer['env_steps_per_second']:.0f} steps/s: free × {ratio['free']:.2f}, "
                f"contact × {ratio['contact']:.2f}"
            )
        return lines

    def as_json(self) -> dict[str, Any]:
        """The report as one JSON object."""
        return json.loads(json.dumps(asdict(self)))


def actions(name: str) -> Iterator[np.ndarray]:
    """What a motion commands, for ever: waving, or closing and squeezing in turn."""
    step = 0
    while True:
        share = 0.5 - 0.5 * np.cos(step / 6) if name == "free" else min(step / 16, 1.0)
        yield np.array([0.3, 1, 1, 1, 1, 0.5]) * share + np.array([-1, -1, -1, -1, -1, 0.5]) * (1 - share)
        step += 1


class Runner:
    """Steps one environment through one kind of motion, episode after episode."""

    def __init__(self, name: str, render_mode: str | None = None) -> None:
        self.env = HandEnv(Grasp(), render_mode=render_mode)
        self._name = name
        self._inside = 0.0
        world = self.env.scene.world
        world.step = self._timed(world.step)
        self.reset()

    def _timed(self, step: Callable[[], None]) -> Callable[[], None]:
        def timed() -> None:
            start = perf_counter()
            step()
            self._inside += perf_counter() - start

        return timed

    def reset(self) -> None:
        """Begin an episode."""
        self.env.reset(seed=0, options={"setup": SETUPS[self._name]})
        self._actions = actions(self._name)

    def warm_up(self) -> None:
        """Go on until the hand has closed."""
        for _ in range(20):
            self.env.step(next(self._actions))

    def measure(self, steps: int) -> tuple[float, float]:
        """Steps a second over some steps of closed hands, resets left out, and the share outside the simulator's own step."""
        spent = inside = 0.0
        for _ in range(steps):
            action = next(self._actions)
            self._inside, start = 0.0, perf_counter()
            over = self.env.step(action)[2]
            spent += perf_counter() - start
            inside += self._inside
            if over:
                self.reset()
                self.warm_up()
        return steps / spent, 1 - inside / spent


def motion(name: str) -> Motion:
    """Measure one kind of motion."""
    runner = Runner(name)
    runner.warm_up()
    rates, shares = zip(*(runner.measure(ROUND_STEPS) for _ in range(ROUNDS)), strict=True)
    resets = [_seconds(runner.reset) for _ in range(20)]
    runner.env.close()
    rate = statistics.median(rates)
    return Motion(rate, rate / CONTROL_HZ, 1e3 * statistics.median(resets), statistics.median(shares))


def _seconds(call: Callable[[], object]) -> float:
    start = perf_counter()
    call()
    return perf_counter() - start


def renders() -> float:
    """Pictures a second."""
    runner = Runner("contact", "rgb_array")
    runner.warm_up()
    times = [_seconds(runner.env.render) for _ in range(8)]
    runner.env.close()
    return 1 / statistics.median(times)


# Processes ------------------------------------------------------------------------------------


def _step_for(seconds: float) -> float:
    runner = Runner("contact")
    runner.warm_up()
    start, steps = perf_counter(), 0
    while perf_counter() - start < seconds:
        runner.measure(20)
        steps += 20
    return steps / (perf_counter() - start)


def _calculate_for(seconds: float) -> float:
    start, rounds, value = perf_counter(), 0, 1.0
    while perf_counter() - start < seconds:
        for _ in range(2000):
            value = value * 1.0000001 + 1e-9
        rounds += 1
    return rounds / (perf_counter() - start)


def _work(task: str, seconds: float, barrier: Any, results: Any) -> None:
    barrier.wait()
    results.put({"env": _step_for, "arithmetic": _calculate_for}[task](seconds))


def together(task: str, processes: int, seconds: float = 2.0) -> float:
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


def scaling() -> tuple[Scaling, ...]:
    """Two and four processes over one."""
    one, one_arithmetic = together("env", 1), together("arithmetic", 1)
    rows = []
    for processes in (2, 4):
        rate = together("env", processes)
        rows.append(Scaling(processes, rate, rate / one, together("arithmetic", processes) / one_arithmetic))
    return tuple(rows)


# The neighbour --------------------------------------------------------------------------------


def peer() -> dict[str, Any] | None:
    """`PEER`, moving freely, beside this library's two motions in alternating rounds; None where panda-gym is not installed."""
    try:
        with quiet_output():  # it prints its colours
            import panda_gym  # noqa: F401  registers its environments

            other = gymnasium.make(PEER).unwrapped
    except ImportError:
        return None
    other.reset(seed=0)
    runners = {name: Runner(name) for name in SETUPS}
    for runner in runners.values():
        runner.warm_up()
    rng, own, its = np.random.default_rng(0), {name: [] for name in runners}, []
    for _ in range(ROUNDS):
        for name, runner in runners.items():
            own[name].append(runner.measure(ROUND_STEPS)[0])
        wanted = [rng.uniform(-1, 1, other.action_space.shape).astype(np.float32) for _ in range(ROUND_STEPS)]
        start = perf_counter()
        for action in wanted:
            other.step(action)
        its.append(ROUND_STEPS / (perf_counter() - start))
    for env in (other, *(runner.env for runner in runners.values())):
        env.close()
    rate = statistics.median(its)
    return {
        "id": PEER,
        "env_steps_per_second": rate,
        "ratio": {name: statistics.median(rates) / rate for name, rates in own.items()},
    }


def report() -> Report:
    """Measure everything."""
    free = HandEnv(Grasp())
    physics_hz = free.scene.world.settings.physics_hz
    free.close()
    return Report(physics_hz, CONTROL_HZ, motion("free"), motion("contact"), renders(), scaling(), peer())
