"""Which seeds train: all below those that judge.

No episode that a policy is judged by was ever started in training.
"""

import numpy as np

from hpac_gym.evaluation.seeds import HELD_OUT_SEED


def training_seed(run_seed: int, steps_done: int, n_envs: int) -> int:
    """The first of ``n_envs`` consecutive seeds with which a run's environments start after ``steps_done`` steps."""
    return int(np.random.default_rng([run_seed, steps_done]).integers(HELD_OUT_SEED - n_envs))
