"""What `hpac record` writes is what happened, and can be learned from."""

import os
import re
import signal
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from agents import RunError, clone
from hpac import main
from hpac_gym.errors import DatasetError
from hpac_gym.evaluation.dataset import _appearing, read_dataset, record
from hpac_gym.model import HPAC
from hpac_gym.output import OutputError
from hpac_gym.policies import read_policy
from hpac_gym.policies.loading import load_policy
from hpac_gym.registration import GENTLE, GRASP, POSTURE
from hpac_gym.tasks.posture import ScriptedPosture
from tests.processes import started, wait_for
from tests.tiny_task import Tiny

EPISODES = 12


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("record") / "scripted"
    record("scripted", "HPAC-Grasp-v0", EPISODES, folder, options={"engine": "mujoco"})
    return folder


def test_a_recording_that_is_ended_leaves_nothing(tmp_path):
    words = ["--policy", "random", "--env", "tests.tiny_task:Tiny-v0", "--episodes", "1000000"]
    with started("-m", "hpac", "record", *words, "--out", f"{tmp_path / 'new'}") as running:
        wait_for(lambda: list(tmp_path.glob(".new-*/*")))
        running.send_signal(signal.SIGTERM)
        _, complaints = running.communicate(timeout=20)
    assert (running.returncode, complaints.splitlines()[-1]) == (130, "interrupted")
    assert not list(tmp_path.iterdir())


def test_the_recorded_environment_seeds_and_actions_give_the_recorded_episodes_again(folder):
    dataset = read_dataset(folder)
    env = dataset.recover_environment()
    for episode in list(dataset.iterate_episodes())[:2]:
        seed = next(iter(dataset.storage.get_episode_metadata([episode.id])))["seed"]
        seen = [env.reset(seed=seed)[0]]
        steps = [env.step(action) for action in episode.actions]
        assert np.array_equal(episode.observations, [*seen, *(step[0] for step in steps)])
        assert np.array_equal(episode.rewards, [step[1] for step in steps])
        assert np.array_equal(episode.terminations, [step[2] for step in steps])
        assert np.array_equal(
            episode.infos["is_success"][1:], [step[4]["is_success"] for step in steps]
        )
        env.reset(seed=seed + 1)
        assert not np.array_equal(episode.observations[1], env.step(episode.actions[0])[0])
    successes = [bool(episode.infos["is_success"][-1]) for episode in dataset.iterate_episodes()]
    assert len(successes) == EPISODES
    assert 0 < sum(successes) < EPISODES
    env.close()


def test_goals_are_recorded_and_cloned_too(tmp_path, monkeypatch):
    """In a round the clone acts, and learns what the script would have done on what it saw."""
    monkeypatch.setattr(clone, "VISITS", 3)
    taught = []
    visit = clone.visit
    monkeypatch.setattr(clone, "visit", lambda *words: taught.append(visit(*words)) or taught[-1])
    dataset = record(
        "scripted",
        "HPAC-Posture-v1",
        2,
        tmp_path / "posture",
        seed_start=5000,
        options={"engine": "mujoco"},
    )
    episode = next(dataset.iterate_episodes())
    assert {name: len(values) for name, values in episode.observations.items()} == dict.fromkeys(
        ("observation", "achieved_goal", "desired_goal"), len(episode.actions) + 1
    )
    clone.main(
        [str(tmp_path / "posture"), "--out", str(tmp_path), "--epochs", "1", "--rounds", "2"]
    )
    with gymnasium.make("hpac_gym:HPAC-Posture-v1", engine="mujoco") as env:
        policy = load_policy(str(tmp_path / "policy.hpac"), env)
        observation, _ = env.reset(seed=0)
        assert env.action_space.contains(policy.predict(observation)[0])
    for seen, wanted in taught:
        assert (seen.shape, wanted.shape) == ((3 * 40, 51), (3 * 40, 6))
        parts = {
            "achieved_goal": seen[:, :15],
            "desired_goal": seen[:, 15:30],
            "observation": seen[:, 30:],
        }
        np.testing.assert_array_equal(ScriptedPosture().act(parts), wanted)
    assert not np.array_equal(*(seen for seen, _ in taught)), "each round has episodes of its own"


def still(env):
    """A policy that keeps the hand half closed, and asks for the id as a file does."""
    assert env.spec
    return SimpleNamespace(predict=lambda seen, state, start: (np.zeros(6, np.float32), state))


@pytest.fixture
def unnumbered():
    """An environment whose id has no version."""
    gymnasium.register("Bare", "tests.tiny_task:Tiny")
    yield "Bare"
    del gymnasium.registry["Bare"]


@pytest.mark.parametrize("before", [None, "elsewhere"])
def test_any_policy_and_id_has_a_name_that_minari_takes_and_keeps_its_module(
    tmp_path, monkeypatch, unnumbered, before
):
    monkeypatch.setenv("MINARI_DATASETS_PATH", before or "")
    if before is None:
        monkeypatch.delenv("MINARI_DATASETS_PATH")
    env_id = f"tests.tiny_task:{unnumbered}" if before else unnumbered
    dataset = record(f"{__name__}:still", env_id, 1, tmp_path / "new")
    assert dataset.spec.dataset_id == "hpac/bare/tests-evaluation-v0"
    assert dataset.spec.env_spec.id == env_id
    assert os.environ.get("MINARI_DATASETS_PATH") == before


def test_an_environment_that_no_text_names_is_not_recorded(tmp_path, unnumbered):
    gymnasium.registry["Bare"].entry_point = Tiny
    with pytest.raises(DatasetError, match="a data set cannot name Bare: Callable found"):
        record(f"{__name__}:still", unnumbered, 1, tmp_path / "new")
    with pytest.raises(DatasetError, match="a data set cannot name HPAC-Grasp-v0: cannot pickle"):
        record("scripted", GRASP, 1, tmp_path / "new", options={"model": HPAC})
    assert list(tmp_path.iterdir()) == []


def test_a_policy_is_recorded_in_its_own_environment_with_the_options_that_it_needs(tmp_path):
    assert main(["record", "--policy", "gentle", "-n", "1", "--out", f"{tmp_path}/new"]) == 0
    spec = read_dataset(tmp_path / "new").spec.env_spec
    assert (spec.id, spec.kwargs["obs"]) == (f"hpac_gym:{GENTLE}", "load")


def test_pictures_are_not_cloned(tmp_path):
    record("random", "tests.tiny_task:Seeing-v0", 1, tmp_path / "seen")
    with pytest.raises(RunError, match=r"seen' observes Dict\(.*\): cloning needs vectors"):
        clone.main([str(tmp_path / "seen"), "--out", str(tmp_path / "policy")])


def test_a_full_disk_is_told_before_hdf5_meets_it(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda folder: SimpleNamespace(free=60_000))
    with pytest.raises(
        OutputError,
        match=r"cannot write 1 episodes to '.*': they need [56]\d,\d{3} bytes, 60,000 are free",
    ):
        record("random", "HPAC-Grasp-v0", 1, tmp_path / "new", options={"engine": "mujoco"})
    assert list(tmp_path.iterdir()) == []


def test_a_clones_successes_are_those_of_whole_episodes(monkeypatch, capsys):
    """A posture tells in every step whether it is the goal's, and an episode ends at the first."""
    monkeypatch.setattr(clone, "VISITS", 4)
    actor = read_policy("posture").actor
    clone.visit(actor, "scripted", POSTURE, {"engine": "mujoco"}, 0)
    assert re.fullmatch(
        r"in training, (0|25|50|75|100)% of 4 episodes won\n", capsys.readouterr().err
    )


def test_a_clone_does_what_it_was_shown(folder, tmp_path, capsys):
    clone.main([str(folder), "--out", str(tmp_path), "--epochs", "60"])
    policy = read_policy(tmp_path / "policy.hpac")
    episode = next(
        episode
        for episode in read_dataset(folder).iterate_episodes()
        if episode.infos["is_success"][-1]
    )
    wrong = np.abs(
        [
            policy.actor(seen) - done
            for seen, done in zip(episode.observations, episode.actions, strict=False)
        ]
    )
    assert wrong.mean() < 0.05
    assert np.abs(np.diff(episode.actions, axis=0)).sum() > 5, "there was something to learn"
    assert policy.about["algorithm"] == "behaviour cloning"
    assert "successful episodes, none kept back: " in capsys.readouterr().out
    with pytest.raises(
        RunError, match=r"policy\.hpac' is there already: choose another folder, or remove it"
    ):
        clone.main([str(folder), "--out", str(tmp_path), "--epochs", "1"])


@pytest.mark.parametrize(
    ("name", "value"), [("observations", np.inf), ("actions", np.nan), ("actions", 7.0)]
)
def test_what_no_environment_gives_is_not_cloned(folder, tmp_path, monkeypatch, name, value):
    dataset = read_dataset(folder)

    def bent():
        for episode in list(read_dataset(folder).iterate_episodes()):
            getattr(episode, name)[3, 2] = value
            yield episode

    monkeypatch.setattr(dataset, "iterate_episodes", bent)
    monkeypatch.setattr(clone, "read_dataset", lambda path: dataset)
    with pytest.raises(
        RunError, match=r"has observations that are not finite, or actions outside −1…1"
    ):
        clone.main([str(folder), "--out", str(tmp_path), "--epochs", "1"])
    assert not (tmp_path / "policy.hpac").exists()


def test_nothing_is_cloned_from_failures_or_from_no_dataset(tmp_path):
    record(
        "random",
        "HPAC-Grasp-v0",
        1,
        tmp_path / "random",
        seed_start=3,
        options={"engine": "mujoco"},
    )
    with pytest.raises(RunError, match="no successful episode among its 1"):
        clone.main([str(tmp_path / "random"), "--out", str(tmp_path / "policy")])
    with pytest.raises(DatasetError, match="is not a dataset"):
        clone.main([str(tmp_path), "--out", str(tmp_path / "policy")])


def test_a_folder_that_another_program_has_made_meanwhile_is_left(tmp_path):
    out = tmp_path / "data"
    with pytest.raises(OutputError, match=r"cannot write '.*data': "), _appearing(out) as root:  # noqa: PT012
        (root / "written").mkdir()
        (out / "other").mkdir(parents=True)
    assert [path.name for path in out.iterdir()] == ["other"]
