"""Worker process of `python -m tools.env_bench`: creates an environment and times it on request.

It reads requests from standard input, one JSON object per line, and answers each with one. It runs
as a script, also in the peers' virtual environment, and therefore imports this package only for
this package's environments."""

import importlib
import json
import os
import sys
import warnings
from collections.abc import Callable
from functools import partial
from time import perf_counter, process_time
from typing import Any

import gymnasium
import numpy as np

WARM_UP_STEPS = 20
"""Steps until the hand has closed on its can; also the warm-up of the peers."""
BLOCKS = 5


def rates(steps: int, step: Callable[[], None], num_envs: int = 1) -> dict[str, float]:
    """Steps of so many environments per second of processor time, and per second."""
    start = process_time()
    began = perf_counter()
    for _ in range(steps):
        step()
    spent = process_time() - start
    passed = perf_counter() - began
    return {"per_cpu_second": num_envs * steps / spent, "per_second": num_envs * steps / passed}


class Stopwatch:
    """An engine whose `advance` and `state` are timed.

    Args:
        engine: the engine.

    Attributes:
        inside: processor time in these calls so far [s].
    """

    def __init__(self, engine: Any) -> None:
        self._engine = engine
        self.inside = 0.0

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._engine, name)
        return partial(self._timed, found) if name in ("advance", "state") else found

    def _timed(self, call: Any, *arguments: Any) -> Any:
        start = process_time()
        result = call(*arguments)
        self.inside += process_time() - start
        return result


class Hands:
    """n hands that hold the same can: every step is in contact. One hand is a single environment, as
    `gymnasium.make` makes it.
    """

    def __init__(self, engine: str, num_envs: int, threads: int) -> None:
        from hpac_gym.body.objects import ObjectSpec
        from hpac_gym.envs import Grasp, HandEnv, HandVectorEnv
        from hpac_gym.physics.engine import SceneSetup
        from hpac_gym.physics.simulation import make_engine

        can = ObjectSpec("cylinder", (0.027, 0.027, 0.05), mass=0.15, friction=0.9)
        opposed = np.array([0, 0, 0, 0, 0, 1.2])
        self.options = {"setup": SceneSetup(can, np.array([0.048, 0.004, 0.112]), 0.0, opposed)}
        if hasattr(os, "sched_setaffinity"):  # an engine uses one thread per available processor
            os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
        self.physics = Stopwatch(make_engine(engine, num_envs))
        self.num_envs = num_envs
        self.env = (
            HandEnv(Grasp(), physics=self.physics)
            if num_envs == 1
            else HandVectorEnv(Grasp(), num_envs, physics=self.physics)
        )
        self.opened = np.array([-1, -1, -1, -1, -1, 0.5])
        self.closed = np.array([0.3, 1, 1, 1, 1, 0.5])

    def _step(self) -> None:
        share = min(self.step_of_episode / 16, 1.0)
        action = (self.closed * share + self.opened * (1 - share)).astype(np.float32)
        self.env.step(action if self.num_envs == 1 else np.tile(action, (self.num_envs, 1)))
        self.step_of_episode += 1

    def measure(self, steps: int) -> dict[str, float]:
        """Step rates of closed hands, within one episode: excluding resets and the closing itself."""
        self.env.reset(seed=0, options=self.options)
        self.step_of_episode = 0
        for _ in range(WARM_UP_STEPS):
            self._step()
        self.physics.inside = 0.0
        found = rates(steps, self._step, self.num_envs)
        spent = steps * self.num_envs / found["per_cpu_second"]
        return found | {"outside": 1 - self.physics.inside / spent}

    def resets(self, count: int) -> dict[str, float]:
        """CPU time per world of starting a random episode [ms]: least of the medians of `BLOCKS`
        blocks of `count` resets.
        """
        times = np.empty((BLOCKS, count))
        for block, number in np.ndindex(times.shape):
            start = process_time()
            self.env.reset(seed=block * count + number)
            times[block, number] = process_time() - start
        return {"reset_ms": 1e3 * float(np.median(times, axis=1).min()) / self.num_envs}


class Peer:
    """An environment of another library, under random actions."""

    def __init__(self, name: str, module: str) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            gymnasium.register_envs(importlib.import_module(module))
            self.env = gymnasium.make(name).unwrapped
        self.rng = np.random.default_rng(0)

    def measure(self, steps: int) -> dict[str, float]:
        """Step rates within one episode."""
        shape = self.env.action_space.shape
        self.env.reset(seed=0)
        actions = iter(self.rng.uniform(-1, 1, (WARM_UP_STEPS + steps, *shape)).astype(np.float32))

        def step() -> None:
            self.env.step(next(actions))

        for _ in range(WARM_UP_STEPS):
            step()
        return rates(steps, step) | {"control_hz": self.env.metadata["render_fps"]}


class Arithmetic:
    """Plain arithmetic, which shows how much of a second processor is available."""

    def measure(self, steps: int) -> dict[str, float]:
        """Rates of steps of 1000 multiplications."""
        return rates(steps, self._multiply)

    def _multiply(self) -> None:
        value = 1.0
        for _ in range(1000):
            value = value * 1.0000001 + 1e-9


KINDS = {"hands": Hands, "peer": Peer, "arithmetic": Arithmetic}


def main() -> None:
    """Answer requests until standard input ends. Output of libraries goes to standard error."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    made: Any = None
    for line in sys.stdin:
        request = json.loads(line)
        call = request.pop("call")
        try:
            if call == "make":
                made = KINDS[request.pop("kind")](**request)
                answer = {}
            else:
                answer = getattr(made, call)(**request)
        except Exception as error:
            answer = {"error": f"{type(error).__name__}: {error}"}
        print(json.dumps(answer), file=answers, flush=True)


if __name__ == "__main__":
    main()
