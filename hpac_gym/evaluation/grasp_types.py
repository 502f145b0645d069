"""Episodes of the sixteen grasp types: whether the executed posture holds the object, and with
which parts of the hand.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import checked_options
from hpac_gym.model import HPAC, action_from_synergy
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.tasks.grasp_types import GraspByType, GraspType
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS


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
    """Gives each new episode the next type of a list."""

    def __init__(self, types: Sequence[GraspType]) -> None:
        super().__init__(wrist="script")
        self.waiting = deque(types)

    def draw(self, rng: np.random.Generator) -> GraspType:
        """The next type of the list."""
        return self.waiting.popleft()


def run_types(
    types: Sequence[GraspType],
    seeds: Sequence[int],
    *,
    engine: str = "pybullet",
    body: str = "twin",
    randomize: str = "nominal",
    num_worlds: int = 1,
    world: WorldSettings = WorldSettings(),
) -> Iterator[tuple[int, TypeTrial]]:
    """Run one episode per type and seed, with a closure that moves straight to the type's posture.

    An episode depends only on its type and seed, not on the episodes that run in parallel.

    Yields:
        Index of the episode in `types`, and its result, in the order in which the episodes end.
    """
    task = _Queue(types)
    worlds = min(num_worlds, len(types))
    options = replace(checked_options(engine=engine, body=body, randomize=randomize), world=world)
    episodes = Episodes(task, worlds, options)
    close_end = round(task.timetable.ends[0] * CONTROL_HZ)
    jobs = iter(range(len(types)))
    job = np.full(worlds, -1)
    steps = np.zeros(worlds, int)
    start = np.zeros((worlds, 6))
    way = np.zeros((worlds, 6))

    def begin(ready: Sequence[int]) -> None:
        for world in ready:
            job[world] = next(jobs, -1)
        began = [world for world in ready if job[world] >= 0]
        if began:
            episodes.reset(began, [np.random.default_rng(seeds[job[world]]) for world in began])
        for world in began:
            grasp = types[job[world]].start
            steps[world] = 0
            start[world] = grasp.preshape
            way[world] = grasp.closed - grasp.preshape

    try:
        begin(range(worlds))
        while (job >= 0).any():
            share = np.minimum(steps / CONTROL_HZ / CLOSE_TIME, 1.0)
            episodes.step(
                action_from_synergy(
                    np.clip(start + share[:, None] * way, HPAC.synergy_min, HPAC.synergy_max)
                )
            )
            steps += 1
            over = (job >= 0) & (episodes.outcome != RUNNING)
            for world in np.flatnonzero(over | (steps == close_end)):
                if not task.hold(
                    world
                ).looks:  # an episode that ends before the hold gets one sample
                    task.look(world, episodes.now.state, episodes.simulation.engine.contacts(world))
            for world in np.flatnonzero(over):
                hold = task.hold(world)
                kind = types[job[world]]
                yield (
                    int(job[world]),
                    TypeTrial(
                        seeds[job[world]],
                        bool(task.free[world]),
                        bool(task.held[world]),
                        bool(episodes.outcome[world] == SUCCESS),
                        steps[world] / CONTROL_HZ / task.duration,
                        kind.rule.clauses(hold),
                        hold.touched,
                        hold.part_force,
                    ),
                )
            begin(np.flatnonzero(over).tolist())
    finally:
        episodes.close()
