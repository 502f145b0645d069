"""Models that Stable-Baselines3 saved are policies wherever a policy goes."""

import contextlib
import json
import pickle
import shutil
import zipfile
from copy import deepcopy
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import sb3_contrib
import stable_baselines3 as sb3
from gymnasium.spaces import Box, Dict
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

import hpac
from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.policies import PolicyError
from hpac_gym.policies.loading import about, load_policy
from hpac_gym.policies.sb3 import statistics_of
from tests.processes import python
from tests.tiny_task import Seeing

TINY = "tests.tiny_task:Tiny-v0"
ON_POLICY = {"n_steps": 16}
OFF_POLICY = {"learning_starts": 20, "policy_kwargs": {"net_arch": [16]}}
ALGORITHMS = {
    "PPO": (sb3.PPO, "MlpPolicy", ON_POLICY | {"batch_size": 16, "use_sde": True}),
    "SAC": (sb3.SAC, "MlpPolicy", OFF_POLICY),
    "TD3": (sb3.TD3, "MlpPolicy", OFF_POLICY),
    "TQC": (sb3_contrib.TQC, "MlpPolicy", OFF_POLICY),
    "CrossQ": (sb3_contrib.CrossQ, "MlpPolicy", OFF_POLICY),
    "RecurrentPPO": (sb3_contrib.RecurrentPPO, "MlpLstmPolicy", ON_POLICY | {"batch_size": 16}),
}


def trained(name: str, folder: Path, normalized: bool = True):
    """A model that has learned for a few steps, saved as `model.zip` with its statistics."""
    algorithm, policy, settings = ALGORITHMS[name]
    envs = DummyVecEnv([lambda: gymnasium.make(TINY)] * 2)
    envs = VecNormalize(envs) if normalized else envs
    model = algorithm(policy, envs, seed=0, device="cpu", **deepcopy(settings))  # it changes them
    model.learn(64)
    model.save(folder / "model.zip")
    if normalized:
        envs.save(str(folder / "vecnormalize.pkl"))
    return model


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A folder with a model of PPO and its statistics."""
    folder = tmp_path_factory.mktemp("saved")
    trained("PPO", folder)
    return folder


@pytest.fixture
def folder(saved, tmp_path):
    return Path(shutil.copytree(saved, tmp_path / "copy"))


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_saved_model_acts_as_it_did_with_its_statistics_and_its_memory(name, tmp_path):
    """Two episodes: it forgets the first when the second begins."""
    model = trained(name, tmp_path)
    env = gymnasium.make(TINY)
    policy = load_policy(str(tmp_path / "model.zip"), env)
    raw = load_policy(str(tmp_path / "model.zip"), env, normalize="none")
    scaling = model.get_vec_normalize_env()
    state = wanted = None
    differ = False
    for step in range(6):
        seen = env.observation_space.sample()
        begins = np.array([step in (0, 3)])
        action, state = policy.predict(seen, state, begins)
        expected, wanted = model.predict(scaling.normalize_obs(seen), wanted, begins, True)
        assert np.array_equal(action, expected)
        differ |= not np.array_equal(action, raw.predict(seen)[0])
    assert differ, "the statistics are used"
    assert (state is not None) == (name == "RecurrentPPO")


@pytest.mark.parametrize("normalized", [True, False])
def test_a_model_that_observes_pictures_acts_as_it_did(normalized, tmp_path):
    """In training Stable-Baselines3 puts the channels of a picture first."""
    envs = DummyVecEnv([Seeing])
    envs = VecNormalize(envs, norm_obs_keys=["deploy"]) if normalized else envs
    model = sb3.PPO("MultiInputPolicy", envs, n_steps=4, batch_size=4, n_epochs=1, device="cpu")
    model.learn(4).save(tmp_path / "model.zip")
    if normalized:
        envs.save(str(tmp_path / "vecnormalize.pkl"))
    seen = Seeing.observation_space.sample()
    policy = load_policy(str(tmp_path / "model.zip"), Seeing())
    scaled = envs.normalize_obs(deepcopy(seen)) if normalized else seen
    np.testing.assert_array_equal(
        policy.predict(seen)[0], model.predict(scaled, None, None, True)[0]
    )


def test_a_model_of_scaled_vectors_beside_pictures_is_refused_without_its_statistics(tmp_path):
    model = sb3.PPO("MultiInputPolicy", DummyVecEnv([Seeing]), n_steps=4, batch_size=4)
    model.learn(4)
    for place, refused in ((0.5, False), (5.0, True)):
        model._last_obs["deploy"][:] = place
        model.save(tmp_path / "model.zip")
        with (
            pytest.raises(PolicyError, match="--normalize") if refused else contextlib.nullcontext()
        ):
            load_policy(str(tmp_path / "model.zip"), Seeing())


def test_hpac_evaluate_takes_a_model_and_tells_what_it_was(saved, capsys):
    words = ["evaluate", "--policy", f"{saved}/model.zip", "--env", TINY, "--episodes", "6"]
    assert hpac.main([*words, "--workers", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert list(told["policies"]) == ["learned", "scripted", "random"]
    assert told["policy"]["env_steps"] == 64
    assert told["policy"]["normalize"] == f"{saved}/vecnormalize.pkl"
    assert len(told["policy"]["normalize_sha256"]) == 64
    assert hpac.main([*words, "--workers", "1"]) == 0
    assert f"observations scaled by '{saved}/vecnormalize.pkl'." in capsys.readouterr().out
    assert told["policy"]["algorithm"] == "stable_baselines3.common.policies"


def test_its_episodes_depend_on_their_seeds_alone(saved):
    whole, part = (
        evaluate([f"{saved}/model.zip"], TINY, count, seed_start=9 - count).episodes["learned"]
        for count in (8, 3)
    )
    assert whole[5:] == part


@pytest.mark.parametrize(
    ("model", "statistics"),
    [
        ("best.zip", "vecnormalize.pkl"),
        ("best.zip", "best/vecnormalize.pkl"),
        ("best.zip", "best.pkl"),
        ("best.zip", "best_vecnormalize.pkl"),
        ("ppo_2000_steps.zip", "ppo_vecnormalize_2000_steps.pkl"),
    ],
)
def test_statistics_are_found_beside_a_model(model, statistics, tmp_path):
    assert statistics_of(tmp_path / model) is None
    (tmp_path / statistics).parent.mkdir(exist_ok=True)
    (tmp_path / statistics).touch()
    assert statistics_of(tmp_path / model) == tmp_path / statistics
    assert statistics_of(tmp_path / model, "none") is None
    assert statistics_of(tmp_path.parent / f"{'x' * 250}.zip") is None


def test_a_model_of_normalised_observations_without_its_statistics_is_refused(folder, tmp_path):
    (folder / "vecnormalize.pkl").rename(folder / "away.pkl")
    env = gymnasium.make(TINY)
    with pytest.raises(PolicyError, match="was trained on normalised observations: name the file"):
        load_policy(f"{folder}/model.zip", env)
    load_policy(f"{folder}/model.zip", env, f"{folder}/away.pkl")
    load_policy(f"{folder}/model.zip", env, "none")
    trained("PPO", tmp_path, normalized=False)
    load_policy(f"{tmp_path}/model.zip", env)  # this one had none


DAMAGE = {
    "no model": lambda folder: zipfile.ZipFile(folder / "model.zip", "w").writestr("a.txt", "a"),
    "broken data": lambda folder: rewrite(folder, "data", b"{"),
    "other weights": lambda folder: rewrite(folder, "policy.pth", b"weights"),
    "statistics of something else": lambda folder: (folder / "vecnormalize.pkl").write_bytes(
        pickle.dumps([1])
    ),
    "statistics of nothing": lambda folder: (folder / "vecnormalize.pkl").write_bytes(b""),
}


def rewrite(folder: Path, name: str, data: bytes) -> None:
    with zipfile.ZipFile(folder / "model.zip") as archive:
        held = {other: archive.read(other) for other in archive.namelist()}
    with zipfile.ZipFile(folder / "model.zip", "w") as archive:
        for other, kept in held.items():
            archive.writestr(other, data if other == name else kept)


def test_statistics_that_cannot_be_read_are_told(folder):
    (folder / "vecnormalize.pkl").unlink()
    (folder / "vecnormalize.pkl").symlink_to("/proc/self/mem")
    with pytest.raises(PolicyError, match=r"cannot read '.*pkl': Input/output error"):
        about(f"{folder}/model.zip")


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_model_ends_in_one_line_that_names_it(damage, folder):
    DAMAGE[damage](folder)
    with pytest.raises(PolicyError) as caught:
        load_policy(f"{folder}/model.zip", gymnasium.make(TINY))
    assert str(folder) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_model_of_another_environment_is_refused(saved):
    other = gymnasium.make("tests.tiny_task:Other-v0")
    remedy = "name the model's environment with --env"
    shapes = rf"has the observation_space \(6,\) float32, Other-v0 has \(7,\) float32: {remedy}"
    with pytest.raises(PolicyError, match=shapes):
        load_policy(f"{saved}/model.zip", other)
    other.observation_space = Box(np.float32([-1, -1, -2, -1, -1, -1]), 1)
    bounds = rf"space \(6,\) float32 with entry 2 in -1…1, .* with entry 2 in -2…1: {remedy}"
    with pytest.raises(PolicyError, match=bounds):
        load_policy(f"{saved}/model.zip", other)
    other.observation_space = Dict(a=Box(0, 1, (2,)), b=Box(0, 255, (8, 8, 3), np.uint8))
    with pytest.raises(PolicyError, match=r"has a \(2,\) float32, b \(8, 8, 3\) uint8: "):
        load_policy(f"{saved}/model.zip", other)
    with pytest.raises(PolicyError, match=r"no VecNormalize statistics 'there\.pkl'"):
        load_policy(f"{saved}/model.zip", gymnasium.make(TINY), "there.pkl")
    assert "env_id" not in about(f"{saved}/model.zip")


def test_statistics_of_another_model_are_refused(folder):
    envs = VecNormalize(DummyVecEnv([lambda: gymnasium.make("tests.tiny_task:Other-v0")]))
    envs.save(f"{folder}/vecnormalize.pkl")
    says = r"statistics of \(7,\) float32, the model observes \(6,\) float32: .*--normalize none"
    with pytest.raises(PolicyError, match=says):
        load_policy(f"{folder}/model.zip", gymnasium.make(TINY))


def test_without_the_library_a_model_is_refused_in_one_line(saved):
    script = f"""
import sys
sys.modules["stable_baselines3"] = None
import hpac
sys.exit(hpac.main(["evaluate", "--policy", "{saved}/model.zip", "--env", "{TINY}", "--episodes", "2"]))
"""
    done = python("-c", script)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert "stable_baselines3" in line
    assert "pip install '.[train]'" in line
