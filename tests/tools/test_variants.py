"""The variants of the recipe differ from it as they say."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from agents import POLICY, RunError
from agents.recipes import RECIPES
from agents.runs import RUN
from agents.trials import training_task
from tools import variants
from tools.variants import GROW, NEAR, VARIANTS, NearFirst, task_maker


def distances(task) -> np.ndarray:
    """Distances of the objects of 1,000 episodes."""
    rng = np.random.default_rng(0)
    return np.array([task.setup(rng).position[2] for _ in range(1_000)])


def test_the_curriculum_begins_with_near_objects_and_ends_with_all():
    recipe = RECIPES["grasp"]
    task = NearFirst(recipe)
    usual = training_task(recipe)
    low, high = usual.config.beyond_wrist
    assert distances(task).max() < low + 1.2 * NEAR * (high - low) < distances(usual).max() - 0.02
    for _ in range(int(GROW * recipe.episodes)):
        task.setup(np.random.default_rng(0))
    assert distances(task).max() > high - 1e-3
    np.testing.assert_array_equal(distances(task), distances(training_task(recipe)))


def test_only_the_curriculum_has_another_task_and_every_other_variant_other_settings():
    named = {name: settings for table in VARIANTS.values() for name, settings in table.items()}
    assert [name for name in named if task_maker(name) is NearFirst] == ["near objects first"]
    recipes = [
        replace(RECIPES["grasp"], **settings)
        for name, settings in named.items()
        if name != "near objects first"
    ]
    assert len({str(recipe) for recipe in recipes}) == len(recipes) == 8


def begun(folder, name: str, trials: int, saved: int) -> None:
    """Leave what a training of a variant with so many trials leaves after some of them."""
    out = folder / f"{name.replace(' ', '-')}-0"
    (out / f"checkpoint-{saved:09d}").mkdir(parents=True)
    (out / POLICY).touch()
    recipe = replace(
        RECIPES["grasp"], episodes=trials, checkpoint_every=trials, **VARIANTS["conditions"][name]
    )
    (out / RUN).write_text(json.dumps(asdict(recipe)))


def test_trainings_with_other_settings_are_not_taken_for_those_of_the_call(tmp_path):
    begun(tmp_path, "as it is", 3_000, 3_000)
    begun(tmp_path, "hands that differ", 4_000, 4_000)
    with pytest.raises(
        RunError,
        match=r"hands-that-differ-0' holds a training with other settings than .* with 3000 trials",
    ):
        variants.main(["conditions", "--seeds", "1", "--trials", "3000", "--out", str(tmp_path)])


def test_finished_trainings_are_kept_and_interrupted_ones_begin_again(tmp_path, monkeypatch):
    trained = []

    def train(recipe, out, *, fresh, make):
        trained.append((recipe.randomize, out.name, fresh))
        return 130

    begun(tmp_path, "as it is", 3_000, 3_000)
    begun(tmp_path, "hands that differ", 3_000, 2_999)
    monkeypatch.setattr(variants, "train", train)
    assert (
        variants.main(["conditions", "--seeds", "1", "--trials", "3000", "--out", str(tmp_path)])
        == 130
    )
    assert trained == [("hand", "hands-that-differ-0", True)]
