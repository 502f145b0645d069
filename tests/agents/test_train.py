"""The training script, run as a person runs it: whole, killed, resumed, stopped, with a full disk."""

import csv
import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from agents import checkpoints
from agents.errors import RunError
from agents.evaluate import evaluate
from agents.learner import actor_of, make_learner, training_env
from agents.recipes import RECIPES, with_settings
from hpac_gym.policies import read_policy

ROOT = Path(__file__).resolve().parents[2]
TINY = "tests.tiny_task:Tiny-v0"
SETTINGS = ["n_envs=2", "hidden=16", "batch_size=32", "learning_starts=100", "checkpoint_every=400", "buffer_size=5000"]
SMALL = [word for text in [f"env_id={TINY}", *SETTINGS] for word in ("--set", text)]


def start(*words) -> subprocess.Popen:
    command = [sys.executable, "-m", "agents.train", *map(str, words)]
    return subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True)


def finish(process: subprocess.Popen, status: int = 0) -> str:
    _, said = process.communicate(timeout=600)
    assert process.returncode == status, said
    return said


def curve(folder: Path) -> list[int]:
    with (folder / "progress.csv").open() as file:
        return [int(row["steps"]) for row in csv.DictReader(file)]


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "whole"
    finish(start("--recipe", "grasp-sac", "--out", folder, "--steps", 1200, "--seed", 3, *SMALL))
    return folder


def test_a_run_leaves_its_policy_curve_settings_and_checkpoint(trained):
    about = read_policy(trained / "policy.zip").about
    assert about["env_id"] == TINY
    assert about["steps"] >= 1200
    assert about["settings"]["seed"] == 3
    assert set(about["versions"]) >= {"python", "torch", "stable_baselines3", "gymnasium", "numpy", "hpac_gym"}
    assert curve(trained)[-1] == about["steps"]
    assert len(list(trained.glob("checkpoint-*"))) == 1
    assert list((trained / "tensorboard").iterdir())
    assert evaluate([str(trained / "policy.zip")], TINY, 5).summary()["policies"]["learned"]["episodes"] == 5


def test_the_same_seed_trains_the_same_policy(trained, tmp_path):
    finish(start("--recipe", "grasp-sac", "--out", tmp_path / "again", "--steps", 1200, "--seed", 3, *SMALL))
    assert read_policy(tmp_path / "again" / "policy.zip").about["sha256"] == read_policy(trained / "policy.zip").about["sha256"]


def test_a_killed_training_goes_on_from_its_last_checkpoint(tmp_path):
    process = start("--recipe", "grasp-sac", "--out", tmp_path, "--steps", 1_000_000, *SMALL)
    try:
        wait_for(lambda: checkpoints.latest_checkpoint(tmp_path), process)
    finally:
        process.kill()
        process.communicate()
    kept = json.loads((checkpoints.latest_checkpoint(tmp_path) / "state.json").read_text())
    aim = kept["steps"] + 600
    finish(start("--out", tmp_path, "--resume", "--steps", aim))
    state = json.loads((checkpoints.latest_checkpoint(tmp_path) / "state.json").read_text())
    assert aim <= state["steps"] < aim + 100
    assert state["updates"] > kept["updates"]
    assert state["seconds"] > kept["seconds"]
    steps = curve(tmp_path)
    assert steps == sorted(set(steps)), "the rows after the checkpoint were taken back"


def test_an_interrupted_training_saves_itself(tmp_path):
    process = start("--recipe", "grasp-sac", "--out", tmp_path, "--steps", 1_000_000, *SMALL)
    wait_for(lambda: checkpoints.latest_checkpoint(tmp_path), process)
    process.send_signal(signal.SIGINT)
    said = finish(process, status=130)
    assert said.splitlines()[-1].startswith("interrupted after")
    assert "Traceback" not in said
    assert checkpoints.latest_checkpoint(tmp_path)


def test_a_time_limit_ends_a_training_cleanly(tmp_path):
    said = finish(start("--recipe", "grasp-sac", "--out", tmp_path, "--time-limit", 0.1, *SMALL))
    assert said.splitlines()[-1].startswith("time limit after")
    assert read_policy(tmp_path / "policy.zip").about["seconds"] >= 6


def wait_for(condition, process: subprocess.Popen, seconds: float = 300) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.fixture(scope="module")
def recipe():
    return with_settings(RECIPES["grasp-sac"], [f"env_id={TINY}", "steps=400", *SETTINGS])


@pytest.fixture(scope="module")
def model(recipe):
    env = training_env(recipe)
    model = make_learner(recipe, env)
    model.learn(400)
    yield model
    env.close()


def test_a_checkpoint_restores_the_learner_whole(model, recipe, tmp_path):
    path = checkpoints.save_checkpoint(tmp_path, model, {"seconds": 1.0})
    env = training_env(recipe)
    other = make_learner(recipe, env)
    state = checkpoints.load_checkpoint(path, other)
    env.close()
    assert state["seconds"] == 1.0
    assert (other.num_timesteps, other._n_updates) == (model.num_timesteps, model._n_updates)
    assert other.replay_buffer.pos == model.replay_buffer.pos
    assert np.array_equal(other.replay_buffer.observations, model.replay_buffer.observations)
    assert np.all(other.replay_buffer.timeouts[other.replay_buffer.pos - 1]), "an episode ends where the run was cut"
    assert other.log_ent_coef.item() == model.log_ent_coef.item()
    seen = np.linspace(-1, 1, 6)
    assert np.array_equal(actor_of(other)(seen), actor_of(model)(seen))
    for name in ("actor", "critic"):
        old, new = (getattr(learner, name).optimizer.state_dict()["state"] for learner in (model, other))
        assert all(np.array_equal(old[key]["exp_avg"], new[key]["exp_avg"]) for key in old)


def test_the_exported_actor_acts_as_the_learner_predicts(model):
    actor = actor_of(model)
    env = model.get_vec_normalize_env()
    for seen in np.random.default_rng(0).uniform(-3, 3, (20, 6)).astype(np.float32):
        expected, _ = model.predict(env.normalize_obs(seen), deterministic=True)
        assert actor(seen) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("failing", ["torch.save", "numpy.savez", "os.fsync", "os.rename"])
def test_a_full_disk_keeps_the_checkpoint_before(model, tmp_path, monkeypatch, failing):
    kept = checkpoints.save_checkpoint(tmp_path, model, {"seconds": 1.0})
    before = {path.name: path.read_bytes() for path in kept.iterdir()}

    def no_space(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(model, "num_timesteps", model.num_timesteps + 1)
    monkeypatch.setattr(failing, no_space)
    with pytest.raises(RunError, match=rf"No space left on device; '{kept.name}' is kept"):
        checkpoints.save_checkpoint(tmp_path, model, {"seconds": 2.0})
    monkeypatch.undo()
    assert list(tmp_path.iterdir()) == [kept]
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == before


@pytest.mark.parametrize("name", ["state.json", "weights.pt", "arrays.npz"])
def test_a_damaged_checkpoint_ends_in_one_error(model, tmp_path, name):
    path = checkpoints.save_checkpoint(tmp_path, model, {"seconds": 1.0})
    data = (path / name).read_bytes()
    (path / name).write_bytes(data[: len(data) // 2])
    with pytest.raises(RunError, match="damaged"):
        checkpoints.load_checkpoint(path, model)
