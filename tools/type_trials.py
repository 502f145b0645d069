"""Episodes of the sixteen grasp types: whether the executed posture holds the object, and with
which parts of the hand.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.envs import HandVectorEnv
from hpac_gym.evaluation.episodes import BATCH, run_episodes
from hpac_gym.model import HPAC, action_from_synergy
from hpac_gym.physics.engine import PARTS
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.physics.simulation import make_engine
from hpac_gym.policies.policy import EpisodePolicy
from hpac_gym.tasks.grasp_data import NamedGrasp
from hpac_gym.tasks.grasp_holds import Hold, part_of
from hpac_gym.tasks.grasp_rules import GraspType
from hpac_gym.tasks.grasp_types import GraspByType
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ


@dataclass(frozen=True, slots=True)
class TypeTrial:
    """Result of one episode of a grasp type."""

    seed: int
    free: bool
    """Whether the hand was clear of the object when it began to close."""
    held: bool
    """Whether the object was lifted, held through the shake and not dropped while lowered, as in
    `hpac_gym.tasks.grasp.Grasp`.
    """
    success: bool
    """Whether the object was held as the type's rule requires."""
    share: float
    """Share of the task's duration at which the episode ended."""
    clauses: dict[str, float]
    """How far each clause of the type's rule was satisfied; 1 if fully."""
    touched: dict[str, float]
    """Share of the hold in which each part of the hand touched the object."""
    force: dict[str, float]
    """Mean normal force of each part during the hold [N]."""


class _Queue(GraspByType):
    """Gives each new episode the next type of a list; the last one to those that nobody asked for."""

    def __init__(self, types: Sequence[GraspType]) -> None:
        super().__init__(wrist="script")
        self.waiting = deque(types)

    def draw(self, rng: np.random.Generator) -> GraspType:
        return self.waiting.popleft() if len(self.waiting) > 1 else self.waiting[0]


class _Straight(EpisodePolicy):
    """Moves straight from the preshape of a type to its posture."""

    def __init__(self) -> None:
        self.grasp: NamedGrasp | None = None

    def _act(self, observation: Any, memory: int | None) -> tuple[NDArray[np.float64], int]:
        step = memory or 0
        way = self.grasp.closed - self.grasp.preshape
        synergy = self.grasp.preshape + min(step / CONTROL_HZ / CLOSE_TIME, 1.0) * way
        bounded = np.clip(synergy, HPAC.synergy_min, HPAC.synergy_max)
        return action_from_synergy(bounded), step + 1


def run_types(
    types: Sequence[GraspType],
    seeds: Sequence[int],
    *,
    engine: str = "pybullet",
    body: str = "twin",
    randomize: str = "nominal",
    world: WorldSettings = WorldSettings(),
) -> Iterator[tuple[int, TypeTrial]]:
    """Run one episode per type and seed, with a closure that moves straight to the type's posture; on
    MuJoCo in a batch.

    An episode depends only on its type and seed, not on the episodes that run in parallel.

    Yields:
        Index of the episode in `types`, and its result, in the order in which the episodes end.
    """
    task = _Queue(types)
    count = min(BATCH, len(types)) if engine == "mujoco" else 1
    physics = make_engine(engine, count, world)
    envs = HandVectorEnv(task, count, "Disabled", physics=physics, body=body, randomize=randomize)
    policies = [_Straight() for _ in range(count)]
    close_end = round(task.timetable.ends[0] * CONTROL_HZ)
    jobs = iter(range(len(types)))
    job = [0] * count
    with closing(envs):
        for step in run_episodes(envs, policies, seeds):
            here = step.world
            if step.number == 0:
                job[here] = next(jobs)
                policies[here].grasp = types[job[here]].start
            hold = task.holds.hold(here)
            # An episode that ends before the hold gets one sample.
            if (step.over or step.number == close_end) and not hold.looks:
                episodes = envs.episodes
                task.holds.look(here, episodes.now.state, episodes.simulation.engine.contacts(here))
                hold = task.holds.hold(here)
            if step.over:
                yield (
                    job[here],
                    TypeTrial(
                        step.seed,
                        bool(task.free[here]),
                        bool(task.held[here]),
                        step.success,
                        step.number / CONTROL_HZ / task.duration,
                        types[job[here]].rule.clauses(hold),
                        hold.touched,
                        _part_force(hold),
                    ),
                )


def _part_force(hold: Hold) -> dict[str, float]:
    """Mean normal force of each part of the hand [N]."""
    pushes = [list(zip(map(part_of, now.links), now.force, strict=True)) for now in hold.looks]
    return {
        part: float(np.mean([sum(force for on, force in each if on == part) for each in pushes]))
        for part in PARTS
    }
