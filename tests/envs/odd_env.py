"""An environment that does what the library's own do not: it waits, and it raises what cannot be pickled."""

import time
from threading import Lock

import gymnasium
import numpy as np
from gymnasium.spaces import Box


class LockedError(Exception):
    """Holds something that no pipe carries."""

    def __init__(self, message: str) -> None:
        super().__init__(message)
        self.lock = Lock()


class OddEnv(gymnasium.Env):
    """Counts its steps. The action 1 waits for a while, 2 raises, 0.5 wins."""

    observation_space = Box(0, 100, (1,), np.int64)
    action_space = Box(0, 2, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return np.array([0]), {}

    def step(self, action):
        if action[0] == 1:
            time.sleep(1.0)
        if action[0] == 2:
            raise LockedError("action 2 is refused")
        self.steps += 1
        return np.array([self.steps]), 1.5, bool(action[0] == 0.5), False, {}
