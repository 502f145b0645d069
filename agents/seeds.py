"""Training seeds, which are all below the held-out seeds of evaluations."""

import numpy as np

from hpac_gym.evaluation.seeds import HELD_OUT_SEED


def training_seed(run_seed: int, steps_done: int, n_envs: int) -> int:
    """First of the ``n_envs`` consecutive seeds of a run's environments when it starts at step ``steps_done``."""
    return int(np.random.default_rng([run_seed, steps_done]).integers(HELD_OUT_SEED - n_envs))
