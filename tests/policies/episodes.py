"""What a policy does in one episode."""

import numpy as np


def actions_of(policy, observations) -> np.ndarray:
    """The actions for the observations of an episode."""
    state = None
    actions = []
    for observation in observations:
        action, state = policy.predict(observation, state)
        actions.append(action)
    return np.array(actions)
