"""Episodes of the sixteen grasp types: whether the posture, executed, holds the object, and by which parts of the hand."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import checked_options
from hpac_gym.model import HPAC, Hand, action_from_synergy
from hpac_gym.physics.engine import SceneSetup, matrix_from_quaternion
from hpac_gym.tasks.grasp import GraspByName
from hpac_gym.tasks.grasp_types import GraspType, Hold
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS

LOOK_EVERY = 4
"""Control steps between two looks at the contacts of a hold."""


@dataclass(frozen=True, slots=True)
class TypeTrial:
    """How one episode of a type ended."""

    seed: int
    free: bool
    """Nothing touched the object when the hand began to close."""
    held: bool
    """Lifted, held through the shake, and not dropped on the way down: `hpac_gym.tasks.grasp.Grasp`."""
    share: float
    """Share of the episode's time that passed before it ended."""
    clauses: dict[str, float]
    """How far each clause of the type's rule was kept; 1 is kept."""
    touched: dict[str, float]
    """Share of the hold in which each part touched."""
    force: dict[str, float]
    """Mean normal force of each part in the hold [N]."""

    @property
    def kept(self) -> bool:
        """Whether the type was kept: every clause of its rule."""
        return all(value >= 1.0 for value in self.clauses.values())

    @property
    def success(self) -> bool:
        """Whether the object was held, and as the type says."""
        return self.free and self.held and self.kept


class _Queue(GraspByName):
    """Draws the episodes of one type after another, in the order in which worlds ask for them."""

    def __init__(self, types: Sequence[GraspType]) -> None:
        super().__init__(types[0].start.name)
        self.waiting = deque(types)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode of the next type."""
        self.grasp = self.waiting.popleft().start
        return super().setup(rng, hand)


def run_types(
    types: Sequence[GraspType], seeds: Sequence[int], *,
    engine: str = "pybullet", body: str = "twin", randomize: str = "nominal", num_worlds: int = 1,
) -> Iterator[tuple[int, TypeTrial]]:  # fmt: skip
    """One episode of each type with its seed, by the closure that goes straight to the type's posture.

    An episode depends on its type and seed alone, whatever runs beside it.

    Yields:
        The episode's place among `types`, and how it ended, in the order in which they end.
    """
    task = _Queue(types)
    worlds = min(num_worlds, len(types))
    episodes = Episodes(task, worlds, checked_options(engine=engine, body=body, randomize=randomize))
    lift_end = round(task.timetable.ends[1] * CONTROL_HZ)
    close_end = round(task.timetable.ends[0] * CONTROL_HZ)
    jobs, job = iter(range(len(types))), np.full(worlds, -1)
    steps, start = np.zeros(worlds, int), np.zeros((worlds, 6))
    way = np.zeros((worlds, 6))
    holds: list[Hold] = [Hold() for _ in range(worlds)]
    free = np.ones(worlds, bool)

    def begin(ready: Sequence[int]) -> None:
        began = []
        for world in ready:
            job[world] = next(jobs, -1)
            if job[world] >= 0:
                began.append(world)
        if not began:
            return
        episodes.reset(began, [np.random.default_rng(seeds[job[world]]) for world in began])
        for world in began:
            grasp, setup = types[job[world]].start, episodes.setups[world]
            steps[world], start[world], way[world] = 0, setup.synergy, grasp.closed - grasp.preshape
            holds[world] = Hold(start=setup_rotation(setup))

    try:
        begin(range(worlds))
        while (job >= 0).any():
            share = np.minimum((steps + 1) / CONTROL_HZ / CLOSE_TIME, 1.0)
            episodes.step(action_from_synergy(np.clip(start + share[:, None] * way, HPAC.synergy_min, HPAC.synergy_max)))
            steps += 1
            state = episodes.now.state
            free = np.where(steps == 1, ~state.touching.any(axis=1), free)
            ready = []
            for world in np.flatnonzero(job >= 0):
                held, over = steps[world] >= lift_end, episodes.outcome[world] != RUNNING
                if steps[world] == close_end or (held and (steps[world] - lift_end) % LOOK_EVERY == 0) or over:
                    if held and steps[world] - lift_end < LOOK_EVERY:
                        holds[world].moments.clear()  # what was seen before the lift tells only of episodes that end with it
                    contacts = episodes.simulation.engine.contacts(world)
                    holds[world].see(contacts, state, world, episodes.setups[world].hand_rotation)
                if over:
                    hold, kind = holds[world], types[job[world]]
                    yield (
                        int(job[world]),
                        TypeTrial(
                            seeds[job[world]], bool(free[world]), bool(episodes.outcome[world] == SUCCESS),
                            steps[world] / CONTROL_HZ / task.duration, kind.rule.clauses(hold), hold.touched, hold.part_force,
                        ),
                    )  # fmt: skip
                    ready.append(world)
            begin(ready)
    finally:
        episodes.close()


def setup_rotation(setup: SceneSetup) -> np.ndarray:
    """Rotation of the object in the hand at the start, shape (3, 3)."""
    return setup.hand_rotation.T @ matrix_from_quaternion(setup.object_turn[0])
