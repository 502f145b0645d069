"""Scripted policies: simple baselines that a learned policy has to beat. A task makes its own
(`Task.script`).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model import HPAC, action_from_synergy
from hpac_gym.tasks.grasp_data import NamedGrasp
from hpac_gym.tasks.phases import CONTROL_HZ, PickPlaceTimetable
from hpac_gym.tasks.terms import LENGTH_UNIT, Layout, Term

CLOSE_TIME = 0.8
"""Duration from open to closed [s]."""
THUMB_CLOSED = 0.8
"""MP of the closed thumb [rad]; with more it pushes small objects out."""
THUMB_OPPOSED = 1.2
"""Constant CMC [rad]."""
THUMB_TIME = 0.7
OPPOSED_TIME = 0.3
"""Closing times of the thumb's MP and CMC in `ScriptedGraspAny` [s]."""
PLACE_TIME = 0.9
PLACE_CLOSED = 0.56
PLACE_THUMB = 0.9
PLACE_OPPOSED = 1.04
"""Closure for pick and place: duration from open to closed [s], fraction of the fingers' full
closure, MP of the closed thumb [rad] and constant CMC [rad]; a hand that closes less releases
sooner."""

_FINGERS = slice(1, -1)
"""Entries of the four fingers in a synergy."""
ANY_WIDTHS = (0.030, 0.050)
"""Boundaries between the kinds: width of the object along the fingers [m]."""
ANY_CLOSURES = {
    (True, 0): (0.99, 0.57, 1.09, -0.02, 1.03),
    (True, 1): (0.99, 0.57, 1.09, -0.02, 1.03),
    (True, 2): (0.94, 0.49, 1.08, -0.02, 1.00),
    (False, 0): (1.02, 0.60, 1.07, 0.15, 0.90),
    (False, 1): (0.97, 0.56, 1.07, 0.08, 1.01),
    (False, 2): (1.02, 0.45, 1.07, 0.05, 0.97),
}
"""Closures by (hand beside the object, index of its width): CMC, MP of the closed thumb, MCP of the
closed fingers [rad]; delay of the thumb after the fingers, negative if it begins before them, and
closing time of the fingers [s]. Means of those random closures that held training objects through
the shake; narrow objects beside the hand, for which too few did, have the next kind's.
"""


class Script:
    """A scripted policy."""

    _time = 0.0
    """Time since the episode began [s]."""

    def reset(self) -> None:
        """Begin an episode."""
        self._time = 0.0

    def act(self, observation: Any) -> NDArray[np.float32]:
        """The next action, shape (6,), −1…1; the numbers of a free wrist follow."""
        raise NotImplementedError

    def _share(self, begin: float, duration: float) -> float:
        """Fraction of a closure from a time on [s] that is complete."""
        return min(max(self._time - begin, 0.0) / duration, 1.0)


class ScriptedClosure(Script):
    """Closes all digits at constant speed, then holds, regardless of the observation.

    Args:
        grasp: grasp from whose preshape to whose closed synergy it moves; None closes the whole
            hand with opposed thumb.
    """

    def __init__(self, grasp: NamedGrasp | None = None) -> None:
        self._open = np.array([0.0, 0.0, 0.0, 0.0, 0.0, THUMB_OPPOSED])
        self._closed = np.array([THUMB_CLOSED, *HPAC.synergy_max[_FINGERS], THUMB_OPPOSED])
        if grasp is not None:
            self._open = grasp.preshape
            self._closed = grasp.closed

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action, shape (6,); the observation is ignored."""
        self._time += 1 / CONTROL_HZ
        synergy = self._open + self._share(0.0, CLOSE_TIME) * (self._closed - self._open)
        return action_from_synergy(synergy).astype(np.float32)


class ScriptedGraspAny(Script):
    """One closure, chosen by the size and pose of the object at the start of the episode, then
    held.

    Args:
        terms: terms of the observations that it receives, as a vector or in a dictionary.
        wrist: number of entries of an action beyond the six for the servos.
    """

    def __init__(self, terms: Sequence[Term], wrist: int = 0) -> None:
        self._slices = Layout(terms, 1).slices
        self._wrist = np.zeros(wrist, np.float32)

    def act(self, observation: NDArray[np.float32] | dict[str, NDArray]) -> NDArray[np.float32]:
        """The next action; it uses only the first observation of an episode, and does not move a
        free wrist.
        """
        if self._time == 0.0:
            vector = observation["deploy"] if isinstance(observation, dict) else observation
            self._closure = ANY_CLOSURES[self.kind(vector)]
        self._time += 1 / CONTROL_HZ
        opposed, thumb, mcp, later, time = self._closure
        fingers = np.minimum(mcp, HPAC.synergy_max[_FINGERS])
        fingers *= self._share(max(-later, 0.0), time)
        thumb *= self._share(max(later, 0.0), THUMB_TIME)
        opposed = THUMB_OPPOSED + (opposed - THUMB_OPPOSED) * self._share(0.0, OPPOSED_TIME)
        action = action_from_synergy([thumb, *fingers, opposed]).astype(np.float32)
        return np.append(action, self._wrist)

    def kind(self, vector: NDArray[np.float32]) -> tuple[bool, int]:
        """Whether the hand is beside the object, and the index of its width along the fingers in
        `ANY_WIDTHS`.
        """
        up, side, half, down = (
            vector[self._slices[name]]
            for name in ("object_up", "object_side", "object_size", "down")
        )
        beside = abs(down[0]) < 0.5
        along = np.array([0.0, 0.0, 1.0]) - down[2] * down  # the fingers' direction, horizontally
        along /= np.linalg.norm(along)
        x, y, z = LENGTH_UNIT * half
        if not up.any():
            width = x
        elif side.any():
            width = (
                abs(along @ side) * x + abs(along @ np.cross(up, side)) * y + abs(along @ up) * z
            )
        else:
            width = abs(along @ up) * z + np.sqrt(max(1 - (along @ up) ** 2, 0.0)) * x
        return beside, int(np.searchsorted(ANY_WIDTHS, 2 * width))


class ScriptedPickPlace(Script):
    """Closes as `ScriptedClosure` once the wrist has arrived, and opens once the object is over its
    target.
    """

    def __init__(self, timetable: PickPlaceTimetable) -> None:
        self._close = timetable.ends[0]
        self._open = timetable.ends[4]

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action, shape (6,); the observation is ignored."""
        self._time += 1 / CONTROL_HZ
        share = self._share(self._close, PLACE_TIME) if self._time < self._open else 0.0
        fingers = PLACE_CLOSED * HPAC.synergy_max[_FINGERS] * share
        synergy = [share * PLACE_THUMB, *fingers, PLACE_OPPOSED]
        return action_from_synergy(synergy).astype(np.float32)
