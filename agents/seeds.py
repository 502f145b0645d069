"""Which seeds train and which judge: two ranges that never meet.

A training run draws the seeds of its environments below ``HELD_OUT_SEED``; an evaluation counts up from there, so that
no episode that a policy is judged by was ever started in training.
"""

import numpy as np

HELD_OUT_SEED = 1_000_000


def training_seed(run_seed: int, steps_done: int, n_envs: int) -> int:
    """The first of ``n_envs`` consecutive seeds with which a run's environments start after ``steps_done`` steps."""
    return int(np.random.default_rng([run_seed, steps_done]).integers(HELD_OUT_SEED - n_envs))
