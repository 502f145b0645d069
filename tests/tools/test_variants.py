"""The variants of the recipe differ from it as they say."""

import numpy as np

from agents.closures import training_task
from agents.recipes import RECIPES
from tools.variants import GROW, NEAR, NearFirst


def distances(task) -> np.ndarray:
    """Distances of the objects of 1,000 episodes."""
    rng = np.random.default_rng(0)
    return np.array([task.setup(rng).position[2] for _ in range(1_000)])


def test_the_curriculum_begins_with_near_objects_and_ends_with_all():
    recipe = RECIPES["grasp"]
    task, usual = NearFirst(recipe), training_task(recipe)
    low, high = usual.config.beyond_wrist
    assert distances(task).max() < low + 1.2 * NEAR * (high - low) < distances(usual).max() - 0.02
    for _ in range(int(GROW * recipe.episodes)):
        task.setup(np.random.default_rng(0))
    assert distances(task).max() > high - 1e-3
    np.testing.assert_array_equal(distances(task), distances(training_task(recipe)))
