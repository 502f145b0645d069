"""A task of ten steps that a few hundred updates learn: point the six actions the way the
observation points.
"""

import gymnasium
import numpy as np
from gymnasium.spaces import Box


class Tiny(gymnasium.Env):
    """Success is that the last action lay nearer to the target than 0.5 in every value."""

    observation_space = Box(-1, 1, (6,), np.float32)
    action_space = Box(-1, 1, (6,), np.float32)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._target = self.np_random.uniform(-1, 1, 6).astype(np.float32)
        self._count = 0
        return self._target, {}

    def step(self, action):
        self._count += 1
        miss = float(np.abs(action - self._target).max())
        done = self._count == 10
        info = {"reward_terms": {"miss": -miss}, "phase": "end" if done else "way"}
        if done:
            info["is_success"] = miss < 0.5
        return self._target, -miss, done, False, info


class Other(Tiny):
    """The same with one value more to see."""

    observation_space = Box(-1, 1, (7,), np.float32)

    def reset(self, *, seed=None, options=None):
        observation, info = super().reset(seed=seed, options=options)
        return np.append(observation, np.float32(0)), info

    def step(self, action):
        observation, *rest = super().step(action)
        return np.append(observation, np.float32(0)), *rest


gymnasium.register("Tiny-v0", Tiny)
gymnasium.register("Other-v0", Other)
