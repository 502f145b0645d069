"""The comparison of trainings takes no other trainings for its own."""

import json
from dataclasses import asdict, replace

import pytest

from agents import POLICY, RunError
from agents.recipes import RECIPES
from agents.runs import RUN
from tools import variants
from tools.variants import VARIANTS


def begun(folder, name: str, trials: int, saved: int) -> None:
    """Leave what a training of a variant with so many trials leaves after some of them."""
    out = folder / f"{name.replace(' ', '-')}-0"
    (out / f"checkpoint-{saved:09d}").mkdir(parents=True)
    (out / POLICY).touch()
    recipe = replace(RECIPES["grasp"], episodes=trials, checkpoint_every=trials, **VARIANTS[name])
    (out / RUN).write_text(json.dumps(asdict(recipe)))


def test_trainings_with_other_settings_are_not_taken_for_those_of_the_call(tmp_path):
    begun(tmp_path, "as it is", 3_000, 3_000)
    begun(tmp_path, "hands that differ", 4_000, 4_000)
    with pytest.raises(
        RunError,
        match=r"hands-that-differ-0' holds a training with other settings than .* with 3000 trials",
    ):
        variants.main(["--seeds", "1", "--trials", "3000", "--out", str(tmp_path)])


def test_finished_trainings_are_kept_and_interrupted_ones_begin_again(tmp_path, monkeypatch):
    trained = []

    def train(recipe, out, *, fresh):
        trained.append((recipe.randomize, out.name, fresh))
        return 130

    begun(tmp_path, "as it is", 3_000, 3_000)
    begun(tmp_path, "hands that differ", 3_000, 2_999)
    monkeypatch.setattr(variants, "train", train)
    assert variants.main(["--seeds", "1", "--trials", "3000", "--out", str(tmp_path)]) == 130
    assert trained == [("hand", "hands-that-differ-0", True)]
