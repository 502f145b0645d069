"""Learning from the trials of finished runs."""

import json
import shutil

import numpy as np
import pytest

from agents import train
from agents.closures import Worlds
from agents.recipes import settings_of
from agents.recorded import Recorded
from hpac_gym.policies import PolicyFile, read_policy, write_policy

SMALL = ["--num-envs", "4", "--hidden", "16", "--batch-size", "16", "--random-episodes", "8", "--checkpoint-every", "8"]
SET_UPS = {"twin": "mujoco/twin", "both": "mujoco/light,mujoco/twin"}
TOGETHER = ["grasp", "--set-ups", "mujoco/twin,mujoco/light", *SMALL]


def run(*words) -> int:
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(train, "_stop_on_signal", lambda progress: None)
        return train.main([str(word) for word in words])


def trials(folder) -> dict[str, np.ndarray]:
    with np.load(train.latest_checkpoint(folder) / "arrays.npz") as file:
        return {name: file[name] for name in ("seen", "decisions", "survived", "came_to")}


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """A run on the twin, one on both bodies, and one that learned from their trials."""
    folder = tmp_path_factory.mktemp("runs")
    for seed, (name, set_ups) in enumerate(SET_UPS.items()):
        assert run("grasp", "--episodes", 20, "--seed", seed, "--set-ups", set_ups, *SMALL, "--out", folder / name) == 0
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.setattr(Worlds, "step", None)  # no physics
        assert run(*TOGETHER, "--trials-of", *(folder / name for name in SET_UPS), "--out", folder / "together") == 0
    return folder


def test_it_learns_from_every_trial_once_without_physics(runs):
    about = {name: read_policy(runs / name / "policy.zip").about for name in (*SET_UPS, "together")}
    assert about["together"]["episodes"] == sum(about[name]["episodes"] for name in SET_UPS)
    assert about["together"]["env_steps"] == pytest.approx(sum(about[name]["env_steps"] for name in SET_UPS), rel=0.05)
    assert about["together"]["settings"]["trials_of"] == [str(runs / name) for name in SET_UPS]
    together, parts = trials(runs / "together"), [trials(runs / name) for name in SET_UPS]
    for name, sensed in (("seen", slice(0, -2)), ("decisions", slice(None)), ("came_to", slice(0, -2))):
        apart = [parts[0][name], parts[1][name][:, sensed]]
        assert sorted(together[name][:, sensed].tolist()) == sorted(np.concatenate(apart).tolist())
    assert not np.array_equal(together["decisions"][: len(parts[0]["decisions"])], parts[0]["decisions"]), "in random order"


def test_critics_are_told_the_set_ups_by_the_numbers_of_the_new_run(runs):
    together, light = trials(runs / "together"), trials(runs / "both")
    on_light = {tuple(row) for row in light["decisions"][light["seen"][:, -2] == 1]}
    told = [tuple(row) in on_light for row in together["decisions"]]
    assert 0 < sum(told) < len(told)
    for name in ("seen", "came_to"):
        np.testing.assert_array_equal(together[name][:, -1], told)
        np.testing.assert_array_equal(together[name][:, -2], np.logical_not(told))


def test_a_resumed_run_goes_on_with_the_trials_that_it_has_not_seen(runs, tmp_path):
    shutil.copytree(runs / "together", tmp_path / "resumed")
    half = [*TOGETHER, "--trials-of", *(runs / name for name in SET_UPS), "--episodes", 16, "--out", tmp_path / "half"]
    assert run(*half) == 0
    settings = json.loads((runs / "together" / "run.json").read_text())
    rest = Recorded(settings_of(settings), done=train.saved_trials(tmp_path / "half")).step(None)[1]
    whole = trials(runs / "together")["decisions"]
    np.testing.assert_array_equal(trials(tmp_path / "half")["decisions"], whole[:16])
    np.testing.assert_array_equal(rest, whole[16 : 16 + len(rest)])


def other_closures(folder):
    policy = read_policy(folder / "policy.zip")
    write_policy(folder / "policy.zip", PolicyFile(policy.actor, policy.about | {"closure": {"goal": [0, 1]}}))


def half_a_checkpoint(folder):
    path = train.latest_checkpoint(folder) / "arrays.npz"
    path.write_bytes(path.read_bytes()[:1000])


@pytest.mark.parametrize(
    ("words", "change", "complaint"),
    [
        (["grasp"], lambda folder: shutil.rmtree(train.latest_checkpoint(folder)), "no trials in .*: it holds no checkpoint"),
        (["grasp"], lambda folder: (folder / "policy.zip").unlink(), "cannot learn from the trials of .*: no policy file"),
        (["grasp"], half_a_checkpoint, "cannot learn from the trials of .*: "),
        (["grasp"], other_closures, "it is of another environment, hand or range of closures"),
        (["pick-place"], None, "it is of another environment, hand or range of closures"),
        (["grasp", "--set-ups", "mujoco/light"], None, "set_ups of this run do not have its mujoco/twin"),
        (["grasp", "--episodes", 1000], None, "episodes is 1,000: the runs have 2. trials together"),
        (["grasp", "--nodes", 1], None, "--trials-of needs no physics, so it does not go with --nodes"),
        (["grasp", "--out", "source", "--overwrite"], None, "whose trials it should learn from: it must be another folder"),
    ],
)
def test_runs_that_cannot_be_learned_from_are_refused_and_kept(runs, tmp_path, monkeypatch, words, change, complaint):
    shutil.copytree(runs / "twin", tmp_path / "source")
    monkeypatch.chdir(tmp_path)
    if change:
        change(tmp_path / "source")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises((train.RunError, train.RecipeError), match=complaint):
        run(*words, *SMALL, "--trials-of", "source", *([] if "--out" in words else ["--out", "new"]))
    assert [path for path in sorted(tmp_path.rglob("*")) if path.name != "new"] == before
