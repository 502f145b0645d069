"""Two motions of the hand, and what they cost: steps a second, resets, pictures.

Free motion is a hand that waves its fingers beside its thumb, with the object out of reach: nothing touches the hand, nor
does it touch itself. In contact it holds a can that it was given.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from hpac_gym.envs import Grasp, HandEnv
from hpac_gym.envs.hand_env import CONTROL_HZ
from hpac_gym.sim import ObjectSpec, SceneSetup

ROUNDS = 7
ROUND_STEPS = 60
WARM_UP_STEPS = 20
_CAN = ObjectSpec("cylinder", (0.027, 0.027, 0.05), mass=0.15, friction=0.9)
_THUMB_ASIDE, _THUMB_OPPOSED = np.zeros(6), np.array([0, 0, 0, 0, 0, 1.2])
SETUPS = {
    "free": SceneSetup(_CAN, np.array([0.25, 0.0, 0.25]), 0.0, _THUMB_ASIDE),
    "contact": SceneSetup(_CAN, np.array([0.048, 0.004, 0.112]), 0.0, _THUMB_OPPOSED),
}
"""An object out of reach, and one in the hand."""
_ENDS = {
    "free": (np.array([-1, -1, -1, -1, -1, -1]), np.array([0.3, 1, 1, 1, 1, -1])),
    "contact": (np.array([-1, -1, -1, -1, -1, 0.5]), np.array([0.3, 1, 1, 1, 1, 0.5])),
}
"""A motion's open and closed hand, as actions. A thumb that is opposed would press through the waving fingers."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What one kind of motion costs."""

    env_steps_per_second: float
    real_time_factor: float
    """Simulated seconds a second."""
    reset_ms: float
    outside_physics_share: float
    """Of a step's time, what is not in the simulator's own step."""


def actions(name: str) -> Iterator[np.ndarray]:
    """What a motion commands, for ever: waving, or closing and squeezing."""
    opened, closed = _ENDS[name]
    step = 0
    while True:
        share = 0.5 - 0.5 * np.cos(step / 6) if name == "free" else min(step / 16, 1.0)
        yield closed * share + opened * (1 - share)
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
        for _ in range(WARM_UP_STEPS):
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


def measure_motion(name: str) -> Motion:
    """Measure one kind of motion."""
    runner = Runner(name)
    runner.warm_up()
    rates, shares = zip(*(runner.measure(ROUND_STEPS) for _ in range(ROUNDS)), strict=True)
    resets = [_seconds(runner.reset) for _ in range(20)]
    runner.env.close()
    rate = statistics.median(rates)
    return Motion(rate, rate / CONTROL_HZ, 1e3 * statistics.median(resets), statistics.median(shares))


def measure_renders() -> float:
    """Pictures a second."""
    runner = Runner("contact", "rgb_array")
    runner.warm_up()
    times = [_seconds(runner.env.render) for _ in range(8)]
    runner.env.close()
    return 1 / statistics.median(times)


def _seconds(call: Callable[[], object]) -> float:
    start = perf_counter()
    call()
    return perf_counter() - start
