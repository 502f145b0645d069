"""Scripted closure: what a person would program first, and what a learned policy has to beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model import HPAC, SERVO_INDEX, action_from_synergy
from hpac_gym.tasks.grasp import GraspByName
from hpac_gym.tasks.grasp_data import NamedGrasp
from hpac_gym.tasks.pick_place import PickPlace, PickPlaceTimetable
from hpac_gym.tasks.task import CONTROL_HZ

CLOSE_TIME = 0.8
"""From open to closed [s]."""
THUMB_CLOSED = 0.8
"""MP of the closed thumb [rad]; farther in it pushes small objects out."""
PLACE_TIME, PLACE_CLOSED, PLACE_THUMB, PLACE_OPPOSED = 0.9, 0.56, 0.9, 1.04
"""When something is to be set down: from open to closed [s], share of the fingers' full closure, MP of the thumb [rad] and CMC,
all the time [rad]; what is wound up less is let go sooner."""
THUMB_OPPOSED = 1.2
"""CMC, all the time [rad]."""


class ScriptedClosure:
    """All digits closed at one speed, then held: it never looks at the object.

    Args:
        grasp: closes from its first shape to its last one; None closes the whole hand, the thumb opposite to the fingers.
    """

    def __init__(self, grasp: NamedGrasp | None = None) -> None:
        self._grasp = grasp

    def reset(self) -> None:
        """Begin an episode."""
        self._time = 0.0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action, shape (6,); the observation is ignored."""
        self._time += 1 / CONTROL_HZ
        share = min(self._time / CLOSE_TIME, 1.0)
        if self._grasp is not None:
            synergy = self._grasp.preshape + share * (self._grasp.closed - self._grasp.preshape)
            return action_from_synergy(synergy).astype(np.float32)
        closed = HPAC.synergy_max.copy()
        closed[SERVO_INDEX["thumb_mp"]] = THUMB_CLOSED
        synergy = closed * share
        synergy[SERVO_INDEX["thumb_cmc"]] = THUMB_OPPOSED
        return action_from_synergy(synergy).astype(np.float32)


class ScriptedPickPlace:
    """Closes as `ScriptedClosure` once the wrist has arrived, and opens once the object is over its target."""

    def __init__(self, timetable: PickPlaceTimetable = PickPlaceTimetable()) -> None:
        self._close, self._open = timetable.ends[0], timetable.ends[4]

    def reset(self) -> None:
        """Begin an episode."""
        self._time = 0.0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action, shape (6,); the observation is ignored."""
        self._time += 1 / CONTROL_HZ
        closed = PLACE_CLOSED * HPAC.synergy_max
        closed[SERVO_INDEX["thumb_mp"]] = PLACE_THUMB
        share = min(max((self._time - self._close) / PLACE_TIME, 0.0), 1.0)
        synergy = closed * (share if self._time < self._open else 0.0)
        synergy[SERVO_INDEX["thumb_cmc"]] = PLACE_OPPOSED
        return action_from_synergy(synergy).astype(np.float32)


def scripted_closure(task: object) -> ScriptedClosure | ScriptedPickPlace:
    """The script for a task: of placing, or the closure of its named grasp, if it has one."""
    if isinstance(task, PickPlace):
        return ScriptedPickPlace(task.timetable)
    return ScriptedClosure(task.grasp if isinstance(task, GraspByName) else None)
