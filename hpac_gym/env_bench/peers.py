"""Environments of other libraries beside this one's two motions, all in the same rounds.

A step is what one call of `step` does: `control_hz` says how much of a second that is, and for this library's `CONTROL_HZ`.
"""

from __future__ import annotations

import importlib
import statistics
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import gymnasium
import numpy as np

from hpac_gym.env_bench import motion
from hpac_gym.sim.quiet import quiet_output

PEERS = {
    "PandaPickAndPlace-v3": "panda_gym",
    "HandManipulateBlock-v1": "gymnasium_robotics",
}
"""Ids and the modules that register them: an arm with PyBullet, a hand with MuJoCo. Both take random actions."""


@dataclass(frozen=True, slots=True)
class Peer:
    """An environment of another library."""

    id: str
    control_hz: float
    env_steps_per_second: float
    ratio: dict[str, float]
    """How many times as many steps a second this library makes, for each motion."""


def made(name: str) -> gymnasium.Env | None:
    """A peer without wrappers; None where its library is not installed."""
    try:
        with quiet_output(), warnings.catch_warnings():  # they greet
            warnings.simplefilter("ignore")
            gymnasium.register_envs(importlib.import_module(PEERS[name]))
            return gymnasium.make(name).unwrapped
    except ImportError:
        return None


def steps_per_second(env: gymnasium.Env, rng: np.random.Generator, steps: int) -> float:
    """Steps a second from a reset on, which is left out."""
    env.reset(seed=0)
    wanted = [rng.uniform(-1, 1, env.action_space.shape).astype(np.float32) for _ in range(steps)]
    start = perf_counter()
    for action in wanted:
        env.step(action)
    return steps / (perf_counter() - start)


def measure_peers() -> tuple[Peer, ...]:
    """Those of `PEERS` that are installed."""
    others = {name: env for name in PEERS if (env := made(name)) is not None}
    if not others:
        return ()
    runners = {name: motion.Runner(name) for name in motion.SETUPS}
    for runner in runners.values():
        runner.warm_up()
    rng = np.random.default_rng(0)
    calls: dict[str, Callable[[], float]] = {
        **{name: lambda runner=runner: runner.measure(motion.ROUND_STEPS)[0] for name, runner in runners.items()},
        **{name: lambda env=env: steps_per_second(env, rng, motion.ROUND_STEPS) for name, env in others.items()},
    }
    rounds = [{name: call() for name, call in calls.items()} for _ in range(motion.ROUNDS)]
    rate = {name: statistics.median(found[name] for found in rounds) for name in calls}
    for env in (*others.values(), *(runner.env for runner in runners.values())):
        env.close()
    return tuple(
        Peer(name, env.metadata["render_fps"], rate[name], {own: rate[own] / rate[name] for own in runners})
        for name, env in others.items()
    )
