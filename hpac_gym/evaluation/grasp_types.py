"""Episodes of the sixteen grasp types: whether the posture, executed, holds the object, and by which parts of the hand."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import checked_options
from hpac_gym.model import HPAC, action_from_synergy
from hpac_gym.tasks.grasp_types import GraspByType, GraspType
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS


@dataclass(frozen=True, slots=True)
class TypeTrial:
    """How one episode of a type ended."""

    seed: int
    free: bool
    """Nothing touched the object when the hand began to close."""
    held: bool
    """Lifted, held through the shake, and not dropped on the way down: `hpac_gym.tasks.grasp.Grasp`."""
    success: bool
    """Held, and as the type's rule asks."""
    share: float
    """Share of the episode's time that passed before it ended."""
    clauses: dict[str, float]
    """How far each clause of the type's rule was kept; 1 is kept."""
    touched: dict[str, float]
    """Share of the hold in which each part touched."""
    force: dict[str, float]
    """Mean normal force of each part in the hold [N]."""


class _Queue(GraspByType):
    """Draws the episodes of one type after another, in the order in which worlds ask for them."""

    def __init__(self, types: Sequence[GraspType]) -> None:
        super().__init__(wrist="script")
        self.waiting = deque(types)

    def draw(self, rng: np.random.Generator) -> GraspType:
        """The type of an episode: the next one."""
        return self.waiting.popleft()


def run_types(
    types: Sequence[GraspType], seeds: Sequence[int], *,
    engine: str = "pybullet", body: str = "twin", randomize: str = "nominal", num_worlds: int = 1,
) -> Iterator[tuple[int, TypeTrial]]:  # fmt: skip
    """One episode of each type with its seed, by the closure that goes straight to the type's posture.

    An episode depends on its type and seed alone, whatever runs beside it.

    Yields:
        The episode's place among `types`, and how it ended, in the order in which they end.
    """
    task, worlds = _Queue(types), min(num_worlds, len(types))
    episodes = Episodes(task, worlds, checked_options(engine=engine, body=body, randomize=randomize))
    close_end = round(task.timetable.ends[0] * CONTROL_HZ)
    jobs, job = iter(range(len(types))), np.full(worlds, -1)
    steps, start, way = np.zeros(worlds, int), np.zeros((worlds, 6)), np.zeros((worlds, 6))

    def begin(ready: Sequence[int]) -> None:
        for world in ready:
            job[world] = next(jobs, -1)
        began = [world for world in ready if job[world] >= 0]
        if began:
            episodes.reset(began, [np.random.default_rng(seeds[job[world]]) for world in began])
        for world in began:
            grasp = types[job[world]].start
            steps[world], start[world], way[world] = 0, grasp.preshape, grasp.closed - grasp.preshape

    try:
        begin(range(worlds))
        while (job >= 0).any():
            share = np.minimum(steps / CONTROL_HZ / CLOSE_TIME, 1.0)
            episodes.step(action_from_synergy(np.clip(start + share[:, None] * way, HPAC.synergy_min, HPAC.synergy_max)))
            steps += 1
            over = (job >= 0) & (episodes.outcome != RUNNING)
            for world in np.flatnonzero(over | (steps == close_end)):
                if not task.hold(world).moments:  # of an episode that ends before it holds, at least this is told
                    task.look(world, episodes.now.state, episodes.simulation.engine.contacts(world))
            for world in np.flatnonzero(over):
                hold, kind = task.hold(world), types[job[world]]
                yield (
                    int(job[world]),
                    TypeTrial(
                        seeds[job[world]], bool(task.free[world]), bool(task.held[world]),
                        bool(episodes.outcome[world] == SUCCESS), steps[world] / CONTROL_HZ / task.duration,
                        kind.rule.clauses(hold), hold.touched, hold.part_force,
                    ),
                )  # fmt: skip
            begin(np.flatnonzero(over).tolist())
    finally:
        episodes.close()
