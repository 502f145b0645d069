"""Collect trials on other machines with Ray Core: collectors on its nodes try closures for one
learner.

A collector has its own worlds and seeds. It gets the learner's networks and scaling as plain
arrays, tries closures until a chunk of trials is complete, and returns the chunk. Each call has one
result, which is added once; that of a collector or node that fails is never added."""

import logging
import os
import platform
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from agents import RunError
from agents.learner import Learner
from agents.recipes import Recipe
from agents.runs import other_versions
from agents.trials import Columns, Source, Trials, sizes_of, worlds_of
from hpac_gym.errors import install
from hpac_gym.evaluation.environment import versions
from hpac_gym.evaluation.seeds import training_seed

# longest wait of a step for a chunk [s], so that a time limit or Ctrl-C can end the training
WAIT_S = 1.0
SILENCE_S = 60.0  # time without a chunk after which a message is printed [s]
QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "RAY_BACKEND_LOG_LEVEL": "fatal",
    "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
    "RAY_DEDUP_LOGS_SKIP_REGEX": ".",
}
"""Settings of Ray, read at its import: no usage reports, and no messages of its own, such as fifty
lines about a lost node.
"""


def connected() -> Any:
    """The module ray, connected to the cluster of ``ray start`` or RAY_ADDRESS, or else to a local
    one.

    Raises:
        RunError: Ray is not installed, or the cluster does not answer.
    """
    os.environ.update(QUIET | os.environ)  # what is set already stays
    try:
        import ray
    except ImportError:
        raise RunError(
            f"collecting on nodes needs Ray, which is not installed: {install('nodes')}"
        ) from None
    try:
        ray.init(
            include_dashboard=False,
            log_to_driver=False,
            logging_level=logging.ERROR,
            ignore_reinit_error=True,
        )
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise RunError(f"no connection to the Ray cluster: {f'{error}'.splitlines()[0]}") from None
    return ray


def knowledge(learner: Learner) -> dict[str, Any]:
    """State that a collector needs for decisions: networks, scaling and number of updates."""
    arrays = learner.networks.arrays().items()
    needed = {name: array for name, array in arrays if not name.startswith("of ")}  # of optimisers
    return needed | {"updates": learner.updates}


class Collector:
    """The worlds of a node with a copy of the learner that decides in them. Ray runs it in a
    separate process.

    Args:
        recipe: the settings of the run, among them the number of worlds; a chunk has at least as
            many trials.
        seed: seed of the first world and of the decisions.
        expected: the learner's `versions`.

    Raises:
        RunError: This node has other library versions, and thus possibly other physics.
    """

    def __init__(self, recipe: Recipe, seed: int, expected: dict[str, str]) -> None:
        if others := other_versions(expected):
            raise RunError(f"the learner has {others}, on node '{platform.node()}'")
        torch.set_num_threads(1)
        self._all_worlds = worlds_of(recipe)
        for worlds in self._all_worlds:
            worlds.start(seed)
        first = self._all_worlds[0]
        self._learner = Learner(
            replace(recipe, episodes=1), first.observed, first.deployed, first.phases
        )
        self._learner.reseed(seed)
        self._num_envs = recipe.num_envs

    def collect(self, known: dict[str, Any]) -> tuple[tuple[np.ndarray, ...], int, float]:
        """Collect a chunk: its trials as arguments of `Trials.add`, its control steps and its
        processor time [s].
        """
        learner = self._learner
        begun = time.process_time()
        learner.networks.restore(known)
        learner.updates = known["updates"]
        parts: list[tuple[np.ndarray, ...]] = []
        while sum(len(part[0]) for part in parts) < self._num_envs:
            parts += [worlds.step(learner) for worlds in self._all_worlds]
        steps = self._num_envs * len(parts) // len(self._all_worlds)
        trials = tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))
        return trials, steps, time.process_time() - begun


class Collectors(Source):
    """Collectors on the nodes of a Ray cluster.

    Each of the `count` collectors takes a free processor, spread over the nodes. A lost collector
    is replaced; its successor waits for a free processor if necessary, while the others continue. A
    resumed run has `done` trials already.

    Attributes:
        steps: control steps of the chunk that the last `step` received.
        trials: number of added trials of each collector.
    """

    def __init__(self, recipe: Recipe, count: int, done: int = 0) -> None:
        self._ray = connected()
        self.observed, self.deployed, self.phases = sizes_of(recipe)
        self._none = tuple(
            Trials(0, self.observed, self.deployed, len(recipe.closures.names)).columns.values()
        )
        self._recipe = recipe
        self._done = done
        self._begun = 0
        self._make = self._ray.remote(num_cpus=1, scheduling_strategy="SPREAD")(Collector)
        self._idle = [self._start() for _ in range(count)]
        self._running: dict[Any, tuple[int, Any]] = {}
        self._heard = self._started = time.monotonic()
        self.trials = Counter[int]()
        self._seconds = Counter[int]()
        self.steps = 0

    def _start(self) -> tuple[int, Any]:
        place = self._begun
        self._begun = self._begun + 1
        seed = training_seed(self._recipe.seed, self._done + place, self._recipe.num_envs)
        return place, self._make.remote(self._recipe, seed, versions())

    def step(self, learner: Learner, meanwhile: Callable[[], None] = lambda: None) -> Columns:
        """Request chunks from idle collectors, call `meanwhile`, and wait briefly for a chunk.

        Returns:
            The trials of a received chunk, as arguments of `Trials.add`; no trials without a chunk.

        Raises:
            RunError: A collector cannot start, or its program failed.
        """
        if self._idle:
            known = self._ray.put(knowledge(learner))
            for place, collector in self._idle:
                self._running[collector.collect.remote(known)] = place, collector
            self._idle.clear()
        meanwhile()
        self.steps = 0
        ready, _ = self._ray.wait(list(self._running), timeout=WAIT_S)
        if time.monotonic() - self._heard > SILENCE_S:
            self._heard = time.monotonic()
            say(
                f"no chunk has come for {SILENCE_S:g} s: 'ray status' tells whether a processor is free"
            )
        return self._received(ready[0]) if ready else self._none

    def _received(self, reference: Any) -> tuple[np.ndarray, ...]:
        errors = self._ray.exceptions
        place, collector = self._running.pop(reference)
        self._heard = time.monotonic()
        try:
            trials, self.steps, seconds = self._ray.get(reference)
        except errors.RayError as error:
            if isinstance(error, errors.RayTaskError) or getattr(error, "actor_init_failed", False):
                raise RunError(
                    f"collector {place} failed: {f'{error}'.strip().splitlines()[-1]}"
                ) from error
            self._ray.kill(collector)
            self._idle.append(self._start())
            say(
                f"collector {place} is lost, and its chunk with it ({type(error).__name__}): collector {self._begun - 1} "
                "takes its place where a processor is free"
            )
            return self._none
        self.trials[place] += len(trials[0])
        self._seconds[place] += seconds
        self._idle.append((place, collector))
        return trials

    def close(self) -> None:
        """End the collectors, and print the number of trials of each."""
        passed = time.monotonic() - self._started
        for place, trials in sorted(self.trials.items()):
            say(
                f"collector {place}: {trials:,} trials, {trials / passed:.1f}/s, "
                f"{trials / self._seconds[place]:.1f} per second of processor time"
            )
        self._ray.shutdown()


def say(text: str) -> None:
    tqdm.write(text, file=sys.stderr)
