"""Episodes from beginning to end."""

import numpy as np

from hpac_gym.sim import ObjectSpec, SceneSetup

EASY = SceneSetup(
    ObjectSpec("cylinder", (0.027, 0.027, 0.05), mass=0.15, friction=0.8),
    np.array([0.048, 0.004, 0.112]), 0.0, np.array([0, 0, 0, 0, 0, 1.2]),
)  # fmt: skip
"""A cylinder in a good place."""


def run(env, policy, setup=None, seed=0) -> tuple[list[dict], float]:
    """One episode: the infos of its steps, and its return."""
    observation, _ = env.reset(seed=seed, options={"setup": setup} if setup else None)
    policy.reset()
    infos, total, over = [], 0.0, False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        infos.append(info)
        total += reward
        over = terminated or truncated
    return infos, total
