"""The rule of the gentle task that `agents.gentle` imitates: what a hand that feels true contact forces
would do, as increments of its synergy. Its numbers were chosen on training seeds."""

from dataclasses import dataclass

import numpy as np

from hpac_gym.model import HPAC, Array, action_from_synergy
from hpac_gym.policies.increments import Increments
from hpac_gym.tasks.task import open_hand

STEPS = 88
"""Control steps of an episode."""
CLOSING = 48
"""Those until the lift."""
LARGEST = np.array([0.06, 0.10, 0.10, 0.10, 0.10, 0.10])
"""Largest increment of each driven joint [rad]."""
PER_RADIAN = 2 / (HPAC.synergy_max - HPAC.synergy_min)
"""Change of an action for a radian of the synergy."""
MOVES = Increments(
    tuple(action_from_synergy(open_hand(1.2)).tolist()), tuple((LARGEST * PER_RADIAN).tolist())
)
UNTOLD = 3.0
"""Crush limit that the rule assumes where none is told [N]."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Numbers of the loop: close fast to just before contact, then by what each digit feels."""

    fast: float = 0.272
    """Synergy until which the fingers close fast, for an object 50 mm from the palm [rad]."""
    fastx: float = 5.61
    """By how much less for each metre more [rad/m]."""
    fstep: float = 0.0635
    step: float = 0.0185
    back: float = 0.00912
    """Increments: fast, largest closing and largest opening one [rad]."""
    gain: float = 0.00973
    """Increment for a newton that is missing [rad/N]."""
    cmc: float = 0.937
    tpre: float = 0.138
    tstep: float = 0.0325
    """CMC; MP up to which the thumb closes fast, and how fast [rad]."""
    delay: float = 8.29
    """Control steps that the thumb waits."""
    phi: float = 0.82
    """Share of the crush limit that is aimed at."""
    thumb: float = 0.871
    """Share of the aim that the thumb presses with."""
    over: float = 1.37
    """Share of the aim beyond which all digits give way."""
    index: float = 0.673
    ring: float = 0.595
    pinky: float = 0.505
    """Weights of the fingers' shares; the middle's is 1."""
    slip: float = 107.0
    """Growth of the aim for each metre that the object slips beyond 2 mm [1/m]."""

    @property
    def shares(self) -> Array:
        """Share of the aim that each finger presses with, shape (4,)."""
        weights = np.array([self.index, 1.0, self.ring, self.pinky])
        return weights / weights.sum()

    def increments(
        self, synergy: Array, step: Array, force: Array, limit: Array, far: Array, slip: Array
    ) -> Array:
        """Increments of n hands, shape (n, 6) [rad].

        Args:
            synergy: shape (n, 6) [rad].
            step: control steps since the episode began, shape (n,).
            force: of the palm, if it is known, and of every digit, shape (n, 6) [N].
            limit: crush limit, shape (n,) [N].
            far: distance from the palm to the object's far side, shape (n,) [m].
            slip: of the object in the hand, shape (n,) [m].
        """
        grown = np.minimum(self.phi * (1 + self.slip * np.maximum(slip - 2e-3, 0.0)), 0.95)
        aim = (grown * limit)[:, None]
        shares = np.append(self.thumb, self.shares)
        squeeze = force.sum(axis=1, keepdims=True) / 2
        move = np.clip(self.gain * (shares * aim - force[:, 1:]), -self.back, self.step)
        move[(squeeze > aim)[:, 0]] = np.minimum(move, 0.0)[(squeeze > aim)[:, 0]]
        move = np.where(squeeze > self.over * aim, -self.back, move)
        fast = np.clip(self.fast - self.fastx * (far - 0.05), 0.0, 1.2)[:, None]
        move[:, 1:] = np.where(synergy[:, 1:5] < fast, self.fstep, move[:, 1:])
        move[:, 0] = np.where(synergy[:, 0] < self.tpre, self.tstep, move[:, 0])
        move[step < self.delay, 0] = 0.0
        return np.column_stack([move, np.clip(self.cmc - synergy[:, 5], -0.1, 0.1)])


RULE = Rule()
