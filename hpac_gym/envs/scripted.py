"""Scripted closure: what a person would program first, and what a learned policy has to beat."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpac_gym.envs.hand_env import CONTROL_HZ
from hpac_gym.model import HPAC, SERVO_INDEX, action_from_synergy

CLOSE_TIME = 0.8
"""From open to closed [s]."""
THUMB_CLOSED = 0.8
"""MP of the closed thumb [rad]; farther in it pushes small objects out."""
THUMB_OPPOSED = 1.2
"""CMC, all the time [rad]."""


class ScriptedClosure:
    """Thumb opposite to the fingers, all digits closed at one speed, then held: it never looks at the object."""

    def reset(self) -> None:
        """Begin an episode."""
        self._time = 0.0

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action, shape (6,); the observation is ignored."""
        self._time += 1 / CONTROL_HZ
        closed = HPAC.synergy_max.copy()
        closed[SERVO_INDEX["thumb_mp"]] = THUMB_CLOSED
        synergy = closed * min(self._time / CLOSE_TIME, 1.0)
        synergy[SERVO_INDEX["thumb_cmc"]] = THUMB_OPPOSED
        return action_from_synergy(synergy).astype(np.float32)
