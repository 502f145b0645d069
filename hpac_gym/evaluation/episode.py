"""One episode of a policy in an environment."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium

from hpac_gym.policies import Policy


def control_steps(
    env: gymnasium.Env, policy: Policy, seed: int
) -> Iterator[tuple[float, dict[str, Any]]]:
    """Run an episode to its end and yield the reward and ``info`` of every control step."""
    observation, _ = env.reset(seed=seed)
    policy.reset(seed)
    done = False
    while not done:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        done = terminated or truncated
        yield float(reward), info
