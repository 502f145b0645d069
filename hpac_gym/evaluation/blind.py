"""Blind closures of `HPAC-Grasp-v0`, and the score that they define.

A blind closure is drawn without observing the object and has no feedback. The floor is the success
rate of the first one drawn for each held-out seed; the ceiling is the rate at which any of those
tried succeeds, which requires luck or knowledge of the object. `python -m tools.blind_search` finds
them."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.policies import Closures
from hpac_gym.policies.policy import EpisodePolicy
from hpac_gym.registration import GRASP

MEASURED_WITH = {"engine": "pybullet", "body": "twin", "randomize": "nominal"}
"""Options of the environment in which the closures were evaluated."""
CLOSURES = Closures(goal=(-1.0, 1.0), duration=(0.0, 32.0), thumb_delay=(-8.0, 8.0))


BLIND = (0.786, 0.502, 0.372, 0.107, -0.113, 0.438, 10.68, 5.71)
"""The most successful of 128 closures on 176 training episodes; `python -m tools.blind_search --blind`
found it.
"""


def action(closure: Sequence[float], step: int) -> NDArray[np.float32]:
    """The action of a closure in a control step, counted from 1, shape (6,).

    Args:
        closure: numbers of `CLOSURES`, unscaled, shape (8,): the final action, −1…1, the CMC's
            being constant; control steps from open to closed; control steps by which the thumb
            starts after the fingers, negative if it starts before them, then partly closed.
        step: the control step.
    """
    late = max(-closure[-1], 0.0)
    decision = CLOSURES.decisions(closure)
    return CLOSURES.actions([decision], [step - 1 + late])[0].astype(np.float32)


class Blind(EpisodePolicy):
    """The policy that executes one closure in every episode; takes an environment, as `load_policy`
    requires.
    """

    def __init__(self, env: object, closure: Sequence[float] = BLIND) -> None:
        self._closure = closure

    def _act(self, observation: Any, memory: int | None) -> tuple[NDArray[np.float32], int]:
        step = (memory or 0) + 1
        return action(self._closure, step), step


FLOOR = 0.33
CEILING = 0.95
"""The two success rates that define the score of `HPAC-Grasp-v0`; the closures that were tried are in
`tools/grasp_closures.csv`.
"""


def score(success: float) -> float:
    """(success − floor) / (ceiling − floor): 0 at the floor, 1 at the ceiling."""
    return (success - FLOOR) / (CEILING - FLOOR)


def has_score(env_id: str, options: Mapping[str, Any] | None = None) -> bool:
    """Whether the score was measured for an id, given with or without its module, and options."""
    given = MEASURED_WITH | {
        name: value for name, value in (options or {}).items() if name not in ("obs", "reward")
    }
    return env_id.rpartition(":")[2] == GRASP and given == MEASURED_WITH
