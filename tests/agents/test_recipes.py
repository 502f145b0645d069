import json
from dataclasses import FrozenInstanceError, asdict

import pytest

from agents import RecipeError
from agents.recipes import RECIPES, settings_of, with_settings
from hpac_gym.evaluation.seeds import HELD_OUT_SEED, training_seed

GRASP = RECIPES["grasp"]


def test_settings_of_every_kind_are_read_and_the_recipe_stays_as_it_was():
    texts = {
        "dropout": "0.2",
        "episodes": " 1_000",
        "hidden": "64, 32",
        "set_ups": "mujoco/twin, pybullet/twin",
    }
    changed = with_settings(GRASP, texts)
    assert (changed.dropout, changed.episodes, changed.hidden) == (0.2, 1000, (64, 32))
    assert changed.set_ups == ("mujoco/twin", "pybullet/twin")
    with pytest.raises(FrozenInstanceError):
        GRASP.dropout = 0.5


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("dropout", "high", "dropout is 'high': it must be a number"),
        ("dropout", "0.95", "dropout is 0.95: it must lie in 0…0.9"),
        ("learning_rate", "nan", "learning_rate is nan"),
        ("episodes", "-1", "episodes is -1: it must lie in 1…1e+08"),
        ("episodes", "1.5", "episodes is '1.5': it must be a whole number"),
        ("hidden", "64,x", "comma-separated whole numbers"),
        ("hidden", "0", "hidden is 0: it must lie in 1…4096"),
        ("hidden", "", "hidden and set_ups need at least one entry"),
        ("num_envs", "0", "num_envs is 0"),
        (
            "set_ups",
            "mujoco/heavy",
            "set_ups is 'mujoco/heavy': it must be one of pybullet/twin, mujoco/twin, mujoco/light",
        ),
        ("set_ups", "pybullet/light", "set_ups is 'pybullet/light': it must be one of"),
        ("release", "9,3", "release is (9.0, 3.0): it must be a lower and an upper bound"),
        ("release", "3,9", "begin and release are given together"),
        ("pessimism", "-1", "pessimism is -1.0: it must lie in 0…10"),
        (
            "script_std",
            "0.1",
            "script_std is 0.1: only HPAC-GraspType-v0 has this setting, not HPAC-Grasp-v0",
        ),
        ("sizes", "0.8,1.2", "only HPAC-GraspAny-v1 has this setting, not HPAC-Grasp-v0"),
        ("hands", "test", "hands is 'test': it must be one of nominal, train"),
        ("hands", "train", "hands is train: only HPAC-GraspAny-v1 has this setting"),
    ],
)
def test_a_wrong_setting_is_refused_in_its_own_terms(name, text, complaint):
    with pytest.raises(RecipeError) as caught:
        with_settings(GRASP, {name: text})
    assert complaint in str(caught.value)


@pytest.mark.parametrize("recipe", RECIPES.values(), ids=RECIPES)
def test_what_a_run_saves_of_its_settings_makes_the_same_recipe(recipe):
    assert settings_of(json.loads(json.dumps(asdict(recipe)))) == recipe


@pytest.mark.parametrize("change", [{"depth": 3}, {"pessimism": None}])
def test_settings_of_another_version_are_refused_by_their_names(change):
    saved = {name: value for name, value in (asdict(GRASP) | change).items() if value is not None}
    with pytest.raises(
        TypeError, match=f"of another version, whose settings differ in {next(iter(change))}"
    ):
        settings_of(saved)


@pytest.mark.parametrize("steps", [0, 1, 123_456, 10_000_000])
def test_training_never_starts_from_a_held_out_seed(steps):
    for run_seed in range(50):
        first = training_seed(run_seed, steps, n_envs=8)
        assert 0 <= first <= first + 7 < HELD_OUT_SEED


def test_a_resumed_training_starts_from_other_seeds():
    assert len({training_seed(0, steps, 4) for steps in range(0, 100_000, 1000)}) > 90
