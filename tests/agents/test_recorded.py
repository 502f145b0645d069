"""Learning from the trials of finished runs."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

from agents import runs as runs_of, train
from agents.recorded import COLUMNS, Recorded
from agents.trials import Worlds
from hpac_gym.policies import PolicyFile, read_policy, write_policy
from tests.agents.small import SMALL, train_here
from tests.processes import killed_at_the_second

SET_UPS = {"twin": "mujoco/twin", "both": "mujoco/light,mujoco/twin"}
TOGETHER = ["grasp", "--set-ups", "mujoco/twin,mujoco/light", *SMALL]


def trials(folder) -> dict[str, np.ndarray]:
    """All trials that a run learned from, in their order."""
    recipe = runs_of.recipe_in(folder)
    if recipe.trials_of:
        return Recorded(recipe, done=runs_of.saved_trials(folder)).tried
    with np.load(runs_of.latest_checkpoint(folder) / "arrays.npz") as file:
        return {name: file[name] for name in COLUMNS}


def learn_together(folder, out, *words) -> None:
    """Learn from the trials of the runs in a folder."""
    train_here(*TOGETHER, "--trials-of", *(folder / name for name in SET_UPS), "--out", out, *words)


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run on the twin, one on both bodies, and one that learned from their trials."""
    folder = tmp_path_factory.mktemp("runs")
    for seed, (name, set_ups) in enumerate(SET_UPS.items()):
        train_here(
            *("grasp", "--episodes", 20, "--seed", seed, "--set-ups", set_ups, *SMALL),
            *("--out", folder / name),
        )
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(Worlds, "step", None)  # no physics
        learn_together(folder, folder / "together")
    return folder


def test_it_learns_from_every_trial_once_without_physics(runs):
    about = {
        name: read_policy(runs / name / "policy.hpac").about for name in (*SET_UPS, "together")
    }
    assert about["together"]["episodes"] == sum(about[name]["episodes"] for name in SET_UPS)
    assert about["together"]["env_steps"] == pytest.approx(
        sum(about[name]["env_steps"] for name in SET_UPS), rel=0.05
    )
    assert about["together"]["settings"]["trials_of"] == [str(runs / name) for name in SET_UPS]
    together = trials(runs / "together")
    parts = [trials(runs / name) for name in SET_UPS]
    for name, sensed in {"seen": -2, "decisions": None, "end_state": -2}.items():
        apart = [parts[0][name], parts[1][name][:, :sensed]]
        assert sorted(together[name][:, :sensed].tolist()) == sorted(np.concatenate(apart).tolist())
    assert not np.array_equal(
        together["decisions"][: len(parts[0]["decisions"])], parts[0]["decisions"]
    ), "in random order"


def test_it_takes_no_more_steps_than_it_may_though_its_trials_come_in_chunks(runs, tmp_path):
    of = [str(runs / name) for name in SET_UPS]
    steps = Recorded(replace(runs_of.recipe_in(runs / "together"), trials_of=of)).steps

    learn_together(runs, tmp_path, "--env-steps", round(2.5 * steps))
    assert read_policy(tmp_path / "policy.hpac").about["env_steps"] == 2 * steps


def test_critics_are_told_the_set_ups_by_the_numbers_of_the_new_run(runs):
    together = trials(runs / "together")
    light = trials(runs / "both")
    on_light = {tuple(row) for row in light["decisions"][light["seen"][:, -2] == 1]}
    told = [tuple(row) in on_light for row in together["decisions"]]
    assert 0 < sum(told) < len(told)
    for name in ("seen", "end_state"):
        np.testing.assert_array_equal(together[name][:, -1], told)
        np.testing.assert_array_equal(together[name][:, -2], np.logical_not(told))


def test_a_killed_and_resumed_run_ends_with_the_same_policy_though_its_checkpoints_hold_no_trials(
    runs, tmp_path
):
    with killed_at_the_second(train, "save_checkpoint"):
        learn_together(runs, tmp_path)
    assert 0 < runs_of.saved_trials(tmp_path) < runs_of.saved_trials(runs / "together")
    with np.load(runs_of.latest_checkpoint(tmp_path) / "arrays.npz") as file:
        assert not set(COLUMNS) & set(file)
    train_here("--resume", "--out", tmp_path)
    ends = (read_policy(folder / "policy.hpac") for folder in (tmp_path, runs / "together"))
    assert len({policy.about["sha256"] for policy in ends}) == 1


@pytest.mark.parametrize("change", ["grown", "replaced"])
def test_a_resumed_run_learns_from_no_other_trials_than_it_began_with(runs, tmp_path, change):
    for name in SET_UPS:
        shutil.copytree(runs / name, tmp_path / name)
    out = tmp_path / "run"
    with killed_at_the_second(train, "save_checkpoint"):
        learn_together(tmp_path, out)
    path = runs_of.latest_checkpoint(tmp_path / "both") / "arrays.npz"
    with np.load(path) as file:
        arrays = dict(file)
    for name in COLUMNS:
        rows = arrays[name]
        arrays[name] = np.concatenate([rows, rows[:1]]) if change == "grown" else rows[::-1]
    np.savez(path, **arrays)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(train.RunError, match=r"'.*/both' no longer has the trials that the run in"):
        train_here("--resume", "--out", out)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def other_closures(folder):
    policy = read_policy(folder / "policy.hpac")
    write_policy(
        folder / "policy.hpac",
        PolicyFile(policy.actor, policy.about | {"closure": {"goal": [0, 1]}}),
    )


def half_a_checkpoint(folder):
    path = runs_of.latest_checkpoint(folder) / "arrays.npz"
    path.write_bytes(path.read_bytes()[:1000])


def learned_from_others(folder):
    path = runs_of.latest_checkpoint(folder) / "arrays.npz"
    with np.load(path) as file:
        np.savez(path, **{name: file[name] for name in file if name not in COLUMNS})


@pytest.mark.parametrize(
    ("words", "change", "complaint"),
    [
        (
            ["grasp"],
            lambda folder: shutil.rmtree(runs_of.latest_checkpoint(folder)),
            "no trials in .*: it holds no checkpoint",
        ),
        (
            ["grasp"],
            lambda folder: (folder / "policy.hpac").unlink(),
            "cannot learn from the trials of .*: no policy file",
        ),
        (["grasp"], half_a_checkpoint, "cannot learn from the trials of .*: "),
        (["grasp"], other_closures, "it is of another environment, hand or range of closures"),
        (
            ["grasp"],
            learned_from_others,
            "its checkpoint has no .*; did it learn from other runs itself?",
        ),
        (["pick-place"], None, "it is of another environment, hand or range of closures"),
        (
            ["grasp", "--set-ups", "mujoco/light"],
            None,
            "set_ups of this run do not have its mujoco/twin",
        ),
        (
            ["grasp", "--episodes", 1000],
            None,
            "episodes is 1,000: the runs have 2. trials together",
        ),
        (
            ["grasp", "--nodes", 1],
            None,
            "--trials-of needs no physics, so it does not go with --nodes",
        ),
        (
            ["grasp", "--out", "source"],
            None,
            "whose trials it should learn from: it must be another folder",
        ),
    ],
)
def test_runs_that_cannot_be_learned_from_are_refused_and_kept(
    runs, tmp_path, monkeypatch, words, change, complaint
):
    for name in ("source", "new"):
        shutil.copytree(runs / "twin", tmp_path / name)
    monkeypatch.chdir(tmp_path)
    if change:
        change(tmp_path / "source")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises((train.RunError, train.RecipeError), match=complaint):
        train_here(
            *words,
            *SMALL,
            "--trials-of",
            "source",
            "--overwrite",
            *([] if "--out" in words else ["--out", "new"]),
        )
    assert sorted(tmp_path.rglob("*")) == before
