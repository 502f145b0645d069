"""What fills the replay buffer before the actor knows anything: random closures instead of white noise.

Uniform noise at 20 Hz averages out in the tendons and hardly ever closes a hand. A random closure takes every digit, within a
random time, to a random place between half open and closed, and keeps it there: no object is looked at, and no closure is
better than another. Where a task has a way to the object and wants it set down again, closures begin and let go at random times.
"""

from __future__ import annotations

import numpy as np

from hpac_gym.model import SERVO_INDEX, SERVOS

_CMC = SERVO_INDEX["thumb_cmc"]
_THUMB = SERVO_INDEX["thumb_mp"]
OPEN = -1.0
DIGIT = (-0.2, 1.0)
"""Range of the thumb's and the fingers' last action."""
OPPOSITION = (-0.2, 0.9)
"""Range of the CMC's action, which is held all the time."""
STEPS = (8.0, 22.0)
"""Range of the control steps from open to closed."""
LEAD = 6.0
"""By how many control steps at most the thumb closes earlier or later than the fingers."""


class RandomClosures:
    """One closure for each of several environments, drawn anew when its episode ends.

    Args:
        n_envs: how many environments.
        action_repeat: control steps that each action is held for.
        rng: what the closures are drawn from.
        begin: range of the control steps before a hand closes.
        release: range of the control steps after which it opens; empty for never.
    """

    def __init__(
        self,
        n_envs: int,
        action_repeat: int,
        rng: np.random.Generator,
        begin: tuple[int, ...] = (0, 0),
        release: tuple[int, ...] = (),
    ) -> None:
        self._rng, self._action_repeat = rng, action_repeat
        self._begin_range, self._release_range = begin, release or (np.inf, np.inf)
        self._goal = np.zeros((n_envs, len(SERVOS)))
        self._steps = np.ones((n_envs, len(SERVOS)))
        self._begin = np.zeros((n_envs, len(SERVOS)))
        self._release = np.zeros((n_envs, 1))
        self._time = np.zeros((n_envs, 1))
        self._draw(np.ones(n_envs, dtype=bool))

    def actions(self, ended: np.ndarray) -> np.ndarray:
        """The next action of every environment, shape (n_envs, 6), −1…1.

        Args:
            ended: whose episode has just ended, shape (n_envs,).
        """
        self._draw(ended)
        self._time += self._action_repeat
        share = np.clip((self._time - self._begin) / self._steps, 0.0, 1.0) * (self._time <= self._release)
        actions = OPEN + share * (self._goal - OPEN)
        actions[:, _CMC] = self._goal[:, _CMC]
        return actions.astype(np.float32)

    def _draw(self, which: np.ndarray) -> None:
        count = int(which.sum())
        self._goal[which] = self._rng.uniform(*DIGIT, (count, len(SERVOS)))
        self._goal[which, _CMC] = self._rng.uniform(*OPPOSITION, count)
        self._steps[which] = self._rng.uniform(*STEPS, (count, 1))
        self._begin[which] = self._drawn(self._begin_range, count)
        self._begin[which, _THUMB] += self._rng.uniform(-LEAD, LEAD, count)
        self._release[which] = self._drawn(self._release_range, count)
        self._time[which] = 0

    def _drawn(self, bounds: tuple[float, ...], count: int) -> np.ndarray:
        low, high = bounds
        return self._rng.uniform(low, high, (count, 1)) if low < high else np.full((count, 1), float(low))
