"""Blind closures of `HPAC-Grasp-v0`, the file of successful ones, and the score scale that they
define.

A blind closure is drawn without observing the object and has no feedback. The floor is the success
rate of the first one drawn for each held-out seed; the ceiling is the rate at which any of those
tried succeeds, which requires luck or knowledge of the object. `python -m tools.blind_search` writes
the file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model import SERVO_INDEX, SERVOS
from hpac_gym.policies import Closures
from hpac_gym.policies.policy import EpisodePolicy

FILE = "grasp_closures.csv"
COLUMNS = ("seed", "tries", *SERVOS, "steps", "lead")
MEASURED_WITH = {"engine": "pybullet", "body": "twin", "randomize": "nominal"}
"""Options of the environment in which the closures were evaluated."""
CLOSURES = Closures(goal=(-1.0, 1.0), duration=(0.0, 32.0), thumb_delay=(-8.0, 8.0))
_CMC = SERVO_INDEX["thumb_cmc"]


@dataclass(frozen=True, slots=True)
class Closure:
    """One of `CLOSURES`, in unscaled numbers; a leading thumb starts partly closed.

    Attributes:
        goal: the final action, shape (6,), −1…1; the CMC's is constant.
        steps: control steps from open to closed.
        lead: control steps by which the thumb starts after the fingers; negative if it starts
            before them.
    """

    goal: tuple[float, ...]
    steps: float
    lead: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Closure:
        """A random closure to targets between half open and closed, in 0.4 to 1.1 s."""
        goal = rng.uniform(-0.2, 1.0, len(SERVOS))
        goal[_CMC] = rng.uniform(-0.2, 0.9)
        steps = rng.uniform(8.0, 22.0)
        lead = rng.uniform(-6.0, 6.0)
        return cls(tuple(goal.round(3).tolist()), round(steps, 2), round(lead, 2))

    def action(self, step: int) -> NDArray[np.float32]:
        """The action of a control step, counted from 1, shape (6,)."""
        decision = CLOSURES.decisions([*self.goal, self.steps, self.lead])
        return CLOSURES.actions([decision], [step - 1 + max(-self.lead, 0.0)])[0].astype(np.float32)


BLIND = Closure((0.786, 0.502, 0.372, 0.107, -0.113, 0.438), steps=10.68, lead=5.71)
"""The most successful of 128 closures on 176 training episodes; `python -m tools.blind_search --blind`
found it.
"""


class Blind(EpisodePolicy):
    """The policy that executes one closure in every episode; takes an environment, as `load_policy`
    requires.
    """

    def __init__(self, env: object, closure: Closure = BLIND) -> None:
        self._closure = closure

    def _act(self, observation: Any, memory: int | None) -> tuple[NDArray[np.float32], int]:
        step = (memory or 0) + 1
        return self._closure.action(step), step


@dataclass(frozen=True, slots=True)
class Try:
    """Result of the search for one held-out seed."""

    seed: int
    tries: int
    """Number of closures tried, up to the first success."""
    closure: Closure | None
    """The first successful closure; None if none succeeded."""

    def row(self) -> str:
        """The result as a line of the file."""
        values = () if self.closure is None else (*self.closure.goal, *astuple(self.closure)[1:])
        return ",".join(map(str, (self.seed, self.tries, *(values or [""] * (len(COLUMNS) - 2)))))

    @classmethod
    def of_row(cls, row: str) -> Try:
        """Parse a line of the file.

        Raises:
            ValueError: The line has the wrong number of values.
        """
        seed, tries, *values = row.split(",")
        if len(values) != len(COLUMNS) - 2:
            raise ValueError(f"row '{row}' has {len(values) + 2} values, not {len(COLUMNS)}")
        if not values[0]:
            return cls(int(seed), int(tries), None)
        *goal, steps, lead = map(float, values)
        return cls(int(seed), int(tries), Closure(tuple(goal), steps, lead))


@dataclass(frozen=True, slots=True)
class Scale:
    """The two success rates that define the score scale."""

    floor: float
    ceiling: float

    def score(self, success: float) -> float:
        """(success − floor) / (ceiling − floor): 0 at the floor, 1 at the ceiling."""
        return (success - self.floor) / (self.ceiling - self.floor)


def share_found(tries: Sequence[Try], within: int) -> float:
    """Share of the seeds for which one of the first ``within`` closures succeeded."""
    return float(np.mean([found.closure is not None and found.tries <= within for found in tries]))


@lru_cache
def winning_closures() -> tuple[Try, ...]:
    """Entries of the committed file, one per held-out seed."""
    head, *rows = (
        files("hpac_gym.evaluation").joinpath("data", FILE).read_text(encoding="utf-8").splitlines()
    )
    if head != ",".join(COLUMNS):
        raise ValueError(f"{FILE} begins with '{head}', not with '{','.join(COLUMNS)}'")
    return tuple(map(Try.of_row, rows))


def scale_of(env_id: str, options: Mapping[str, Any] | None = None) -> Scale | None:
    """The scale of an id, given with or without its module; None if the id or the options have no
    measured scale.
    """
    given = MEASURED_WITH | {
        name: value for name, value in (options or {}).items() if name not in ("obs", "reward")
    }
    if env_id.rpartition(":")[2] != "HPAC-Grasp-v0" or given != MEASURED_WITH:
        return None
    tries = winning_closures()
    return Scale(share_found(tries, 1), share_found(tries, max(found.tries for found in tries)))
