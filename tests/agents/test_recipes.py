from dataclasses import FrozenInstanceError, replace

import pytest

from agents.errors import RecipeError
from agents.recipes import BOUNDS, RECIPES, recipe_named, with_settings
from agents.seeds import training_seed
from hpac_gym.evaluation.seeds import HELD_OUT_SEED

GRASP = RECIPES["grasp-sac"]


def test_settings_of_every_kind_are_read_and_the_recipe_stays_as_it_was():
    changed = with_settings(GRASP, ["gamma=0.98", "steps = 1_000", "hidden=64,32", "env_id=tests:Any-v1"])
    assert (changed.gamma, changed.steps, changed.hidden, changed.env_id) == (0.98, 1000, (64, 32), "tests:Any-v1")
    assert recipe_named("grasp-sac") is GRASP
    with pytest.raises(FrozenInstanceError):
        GRASP.gamma = 0.5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("gamma", "not of the form name=value"),
        ("gama=0.9", "unknown setting 'gama': known are env_id"),
        ("gamma=high", "gamma is 'high': it must be a number"),
        ("gamma=1.5", "gamma is 1.5: it must lie in 0…1"),
        ("gamma=nan", "gamma is nan"),
        ("steps=-1", "steps is -1: it must lie in 1…inf"),
        ("steps=1.5", "steps is '1.5': it must be a whole number"),
        ("hidden=64,x", "whole numbers with commas between"),
        ("hidden=0", "hidden is 0: it must lie in 1…4096"),
        ("n_envs=0", "n_envs is 0"),
        ("buffer_size=10", "buffer_size is 10: it must hold learning_starts"),
    ],
)
def test_a_wrong_setting_is_refused_in_its_own_terms(text, complaint):
    with pytest.raises(RecipeError) as caught:
        with_settings(GRASP, [text])
    assert complaint in str(caught.value)


def test_every_number_of_a_recipe_has_bounds():
    numbers = {name for name in GRASP.__slots__ if name != "env_id"}
    assert numbers == set(BOUNDS)


@pytest.mark.parametrize("steps", [0, 1, 123_456, 10_000_000])
def test_training_never_starts_from_a_held_out_seed(steps):
    for run_seed in range(50):
        first = training_seed(run_seed, steps, n_envs=8)
        assert 0 <= first <= first + 7 < HELD_OUT_SEED


def test_a_resumed_training_starts_from_other_seeds():
    assert len({training_seed(0, steps, 4) for steps in range(0, 100_000, 1000)}) > 90


def test_a_recipe_with_a_bad_number_cannot_be_made():
    with pytest.raises(RecipeError, match="tau"):
        replace(GRASP, tau=0.0)
