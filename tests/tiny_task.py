"""A task of ten steps that a few hundred updates learn: point the six actions the way the
observation points.
"""

from typing import ClassVar

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Dict


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


class Filmed(Tiny):
    """The same with pictures."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}

    def __init__(self, render_mode):
        self.render_mode = render_mode

    def render(self):
        return np.full((32, 32, 3), 20 * self._count, np.uint8)


class Seeing(gymnasium.Env):
    """Episodes of one step, in which it observes a picture beside a vector."""

    observation_space = Dict(deploy=Box(-1, 1, (3,)), image=Box(0, 255, (36, 36, 3), np.uint8))
    action_space = Box(-1, 1, (6,))

    def reset(self, seed=None, options=None):
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, True, False, {}


for kind in (Tiny, Other, Filmed, Seeing):
    gymnasium.register(f"{kind.__name__}-v0", f"{__name__}:{kind.__name__}")
