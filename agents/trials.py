"""Trials of closures: the table of them, what gives them, and the worlds in which they are run."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np

from agents import RecipeError
from agents.recipes import Recipe
from hpac_gym.envs import GraspAnyConfig, make_task
from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import COMMON, checked_options
from hpac_gym.evaluation.environment import with_object
from hpac_gym.registration import GRASP_ANY, GRASP_TYPE, row_of
from hpac_gym.settings import settings_from
from hpac_gym.tasks.phases import Timetable
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS, Task

Columns = tuple[np.ndarray, ...]
"""Columns of trials, as arguments of `Trials.add`."""

SHORT = GraspAnyConfig(
    timetable=Timetable(close_time=1.6, clearance=Timetable().lift_height),
    side_time=1 / CONTROL_HZ,
    ramp_time=1 / CONTROL_HZ,
)
"""HPAC-GraspAny-v1 without the time that a single closure does not use, and without the phases
after success.
"""
_COMMON = {option.name for option in COMMON}
DRAWS = 4  # maximal number of draws of an episode until the learner accepts it
WEAK = (0.5, 1.0)
"""Factors of the skin's friction in weak contacts (`docs/physics.md`: PyBullet's contacts hold half
of the friction cone).
"""


class Trials:
    """Trials of closures, one per row: a table with room for `size` of them, of which `count` are
    in use.

    Attributes:
        seen: first observation of the episode, *privileged*, shape (size, observed).
        decisions: decision for a closure, −1…1, shape (size, decided).
        survived: number of phases that the closure survived, shape (size,).
        end_state: privileged entries at the end of the closing, or of the trial if earlier, shape
            (size, observed − deployed).
        columns: these arrays by name.
    """

    def __init__(self, size: int, observed: int, deployed: int, decided: int) -> None:
        self.seen = np.zeros((size, observed), np.float32)
        self.decisions = np.zeros((size, decided), np.float32)
        self.survived = np.zeros(size, np.int64)
        self.end_state = np.zeros((size, observed - deployed), np.float32)
        self.columns = dict(vars(self))
        self.count = 0

    def add(self, *trials: np.ndarray) -> None:
        """Append the `columns` of trials; those beyond the room of the table are dropped."""
        rows = slice(self.count, self.count + len(trials[0]))
        room = len(self.survived[rows])
        for kept, given in zip(self.columns.values(), trials, strict=True):
            kept[rows] = given[:room]
        self.count += room


class Source(Protocol):
    """What gives trials to a learner: worlds, collectors on other machines, or finished runs.

    Attributes:
        observed: size of a first observation: *privileged*, and the numbers of the set-ups.
        deployed: number of its first entries, the *deploy* observation.
        phases: number of phases of the task.
        steps: control steps that the last `step` took, over all worlds.
        tried: columns of trials that the checkpoints of a run leave out, by name.
        hashes: of the trials of finished runs, by their folders.
    """

    observed: int
    deployed: int
    phases: int
    steps: int
    tried: Mapping[str, np.ndarray] = MappingProxyType({})
    hashes: Mapping[str, str] = MappingProxyType({})

    def start(self, seed: int) -> None:
        """Begin new episodes, if they are begun here."""

    def step(self, learner: Any, meanwhile: Callable[[], None] = lambda: None) -> Columns:
        """Call `meanwhile`, and return the trials that have ended since the last step; `learner`,
        an `agents.learner.Learner`, decides on the closures to try.
        """

    def close(self) -> None:
        """Free what the source holds; may be called repeatedly."""


class Worlds(Source):
    """n worlds in which closures are tried; each starts a new episode as soon as its last one has
    ended.

    The set-ups of a recipe share its worlds equally; these are the worlds of the set-up at index
    `place`. With several set-ups, the critics are told by one number each which of them a trial
    had, and the actor is not.

    Attributes:
        observed: size of a first observation: *privileged*, and the numbers of the set-ups.
        deployed: number of its first entries, the *deploy* observation.
        phases: number of phases of the task.
        first_seen: first observations of the running episodes, shape (n, observed).
        steps: control steps of all its worlds in a call of `step`.
    """

    def __init__(self, task: Task, recipe: Recipe, place: int) -> None:
        set_ups = len(recipe.set_ups)
        self._first, end = (recipe.num_envs * bound // set_ups for bound in (place, place + 1))
        engine, body = recipe.set_ups[place].split("/")
        told = {**row_of(recipe.env_id).defaults, **recipe.options}
        given = {name: value for name, value in told.items() if name in _COMMON}
        fixed = {"obs": "privileged", "engine": engine, "body": body}
        options = checked_options(**given | fixed | {"randomize": recipe.randomize})
        if (
            recipe.contacts == "weak"
        ):  # no torsional friction, and less of the skin's, drawn for each episode
            low, high = options.randomize.skin_friction
            randomize = replace(options.randomize, skin_friction=(WEAK[0] * low, WEAK[1] * high))
            options = replace(
                options, randomize=randomize, world=replace(options.world, torsion=0.0)
            )
        count = self.steps = end - self._first
        self.episodes = Episodes(task, count, options)
        self._told = np.tile(
            np.eye(set_ups, dtype=np.float32)[place, : set_ups if set_ups > 1 else 0], (count, 1)
        )
        self.deployed = sum(len(term.labels) for term in task.terms)
        self.phases = len(task.phases)
        self.observed = self.episodes.observations.space.shape[0] + self._told.shape[1]
        self.first_seen = np.zeros((count, self.observed), np.float32)
        self._end_state = self.first_seen[:, self.deployed :].copy()
        self._close = task.phases.index("close") if "close" in task.phases else self.phases
        self._closures = recipe.closures
        self._decisions = np.zeros((count, len(self._closures.names)))
        self._steps = np.zeros(count, dtype=int)
        self._most_steps = row_of(recipe.env_id).max_episode_steps or np.inf
        self._thread = ThreadPoolExecutor(1)

    def start(self, seed: int) -> None:
        """Drop the running episodes and begin others; `seed` is that of the recipe's first world,
        the others count upwards.
        """
        self._generators = [
            np.random.default_rng(seed + self._first + world) for world in range(self.steps)
        ]
        self._begin(np.arange(self.steps))

    def step(self, learner: Any, meanwhile: Callable[[], None] = lambda: None) -> Columns:
        """Advance all worlds by one control period, and begin new episodes where some ended.

        Args:
            learner: makes the decisions and selects the trials to run.
            meanwhile: called while another thread advances the worlds, to use two cores.

        Returns:
            The trials that ended, as arguments of `Trials.add`.
        """
        worlds = np.flatnonzero(self._steps == 0)
        for draw in range(DRAWS):
            if not len(worlds):
                break
            if draw:
                self._begin(worlds)
            self._decisions[worlds] = learner.decide(self.first_seen[worlds])
            worlds = worlds[~learner.accepted(self.first_seen[worlds], self._decisions[worlds])]
        advancing = self._thread.submit(self._advance)
        meanwhile()
        return advancing.result()

    def _begin(self, worlds: np.ndarray) -> None:
        self.episodes.reset(worlds.tolist(), [self._generators[world] for world in worlds])
        self.first_seen[worlds] = self._seen()[worlds]
        self._steps[worlds] = 0

    def _advance(self) -> Columns:
        phase = self.episodes.now.phase.copy()
        self.episodes.step(self._closures.actions(self._decisions, self._steps).astype(np.float32))
        self._steps += 1
        closing = phase <= self._close
        self._end_state[closing] = self._seen()[closing, self.deployed :]
        over = (self.episodes.outcome != RUNNING) | (self._steps >= self._most_steps)
        ended = np.flatnonzero(over)
        held = self.episodes.outcome[ended] == SUCCESS
        survived = np.where(held, self.phases, phase[ended])
        columns = self.first_seen, self._decisions, self._end_state
        seen, decisions, end_state = (column[ended] for column in columns)
        if len(ended):
            self._begin(ended)
        return seen, decisions, survived, end_state

    def _seen(self) -> np.ndarray:
        return np.hstack([self.episodes.observe(), self._told])

    def close(self) -> None:
        self._thread.shutdown()
        self.episodes.close()


def training_task(recipe: Recipe) -> Task:
    """A new task of a recipe.

    Raises:
        EnvError: The id is unknown, or an option is invalid.
        RecipeError: The task has no such option, or has goals.
    """
    given = with_object(recipe.options)
    options = {name: value for name, value in given.items() if name not in _COMMON}
    if recipe.env_id == GRASP_ANY:
        short = replace(SHORT, size=recipe.sizes or SHORT.size)
        config = settings_from(short, options.get("config"), "config")
        options = {"hands": recipe.hands, **options, "config": config}
    elif recipe.env_id == GRASP_TYPE:
        options = {"types": "train", **options}
    try:
        task = make_task(recipe.env_id, **options)
    except TypeError as error:
        raise RecipeError(f"env is '{recipe.env_id}', and has no such option: {error}") from None
    if task.goal_terms:
        raise RecipeError(f"env is '{recipe.env_id}': a closure cannot follow goals")
    return task


def worlds_of(recipe: Recipe) -> list[Worlds]:
    """The worlds of each set-up of a recipe, each with a task of its own; they need a
    `Worlds.start`.
    """
    return [Worlds(training_task(recipe), recipe, place) for place in range(len(recipe.set_ups))]


def sizes_of(recipe: Recipe) -> tuple[int, int, int]:
    """Numbers `observed`, `deployed` and `phases` of the worlds of a recipe, which need not
    exist.
    """
    samples = worlds_of(replace(recipe, num_envs=len(recipe.set_ups)))
    for sample in samples:
        sample.close()
    return samples[0].observed, samples[0].deployed, samples[0].phases
