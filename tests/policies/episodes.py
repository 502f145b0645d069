"""A small policy, and what a policy does in one episode."""

from itertools import pairwise

import numpy as np

from hpac_gym.policies import Actor, PolicyFile


def tiny_policy(**about) -> PolicyFile:
    """A policy of `Tiny-v0` that learned nothing, with this in its description."""
    rng = np.random.default_rng(0)
    layers = tuple(
        (rng.normal(size=(n, m)).astype(np.float32), rng.normal(size=n).astype(np.float32))
        for m, n in pairwise((6, 8, 6))
    )
    actor = Actor(rng.normal(size=6), rng.uniform(0.5, 2, 6), 10.0, layers, 2.0)
    return PolicyFile(actor, {"env_id": "tests.tiny_task:Tiny-v0", **about})


def actions_of(policy, observations) -> np.ndarray:
    """The actions for the observations of an episode."""
    state = None
    actions = []
    for observation in observations:
        action, state = policy.predict(observation, state)
        actions.append(action)
    return np.array(actions)
