"""Each example runs in a folder of its own, without the checkout, and what it writes is a policy; the
notebook and the settings for RL Zoo do what they say.
"""

import json
import re
import shutil
from inspect import signature
from pathlib import Path

import gymnasium
import pytest
import yaml

import hpac_gym
from hpac_gym.policies.loading import load_policy
from tests.processes import python

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NOTEBOOK = EXAMPLES / "quickstart.ipynb"
ZOO = EXAMPLES / "rl_zoo3_ppo.yml"
WORDS = {
    "one_step_sac": ["--episodes=40", "--random-episodes=16", "--num-envs=8", "--batch-size=8"],
    "ppo": ["--total-steps=300", "--num-envs=2", "--rollout=70", "--batch-size=64", "--epochs=1"],
    "sb3_ppo": ["--total-steps=200", "--num-envs=2"],
}
WRITES = {"one_step_sac": "policy.hpac", "ppo": "policy.hpac", "sb3_ppo": "model.zip"}


def test_every_example_is_run_here():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == set(WORDS)


@pytest.mark.parametrize("name", WORDS)
def test_an_example_is_one_short_file_on_the_public_api(name):
    text = (EXAMPLES / f"{name}.py").read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 150
    imported = re.findall(r"^(?:from|import) ([\w.]+)", text, re.MULTILINE)
    assert not [module for module in imported if module.split(".")[0] in ("agents", "tests")]
    inside = [module for module in imported if module.startswith("hpac_gym.")]
    assert set(inside) <= {"hpac_gym.policies", "hpac_gym.policies.made_for", "hpac_gym.envs.sb3"}


SHORT = ["--episodes=16", "--num-envs=8", "--batch-size=8"]  # all of its episodes are random
ONE_AFTER_THE_OTHER = """
import json, runpy, sys
for line in json.loads(sys.argv[1]):
    sys.argv = line
    runpy.run_path(line[0], run_name="__main__")
"""
"""In one process, which loads PyTorch once."""


def test_an_example_trains_a_policy_wherever_it_is_copied(tmp_path):
    for name in WORDS:
        shutil.copy(EXAMPLES / f"{name}.py", tmp_path)
    only_the_package = tmp_path / "package"
    only_the_package.mkdir()
    (only_the_package / "hpac_gym").symlink_to(Path(hpac_gym.__file__).parent)
    lines = [[f"{name}.py", "--out", name, *words] for name, words in WORDS.items()]
    lines.append(["one_step_sac.py", "--out", "short", *SHORT])
    refused = ["one_step_sac.py", "--env", "hpac_gym:HPAC-GraspType-v0"]
    done = python(
        *("-c", ONE_AFTER_THE_OTHER, json.dumps([*lines, refused])),
        folder=tmp_path,
        PYTHONPATH=str(only_the_package),
    )
    said = (
        "error: env is 'hpac_gym:HPAC-GraspType-v0': a closure sees a vector and gives six actions"
    )
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, said)
    with gymnasium.make("hpac_gym:HPAC-Grasp-v0", engine="mujoco") as env:
        for name, _, out, *_ in lines:
            written = f"{out}/{WRITES[name.removesuffix('.py')]}"
            assert written in done.stdout.splitlines()
            policy = load_policy(str(tmp_path / written), env)
            assert policy.predict(env.reset(seed=0)[0])[0] in env.action_space


def test_the_notebook_runs_and_holds_no_outputs(tmp_path):
    cells = [
        cell
        for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == "code"
    ]
    assert not any(cell["outputs"] for cell in cells)
    program = "\n".join("".join(cell["source"]) for cell in cells)
    done = python("-c", program, folder=tmp_path, MPLBACKEND="agg")
    assert done.returncode == 0, done.stderr
    outcome, learned, scripted, terms = done.stdout.splitlines()
    assert outcome.startswith("success held for")
    assert learned.startswith("learned ")
    assert int(learned.split()[1]) > int(scripted.split()[1])
    assert "effort" in terms


@pytest.mark.parametrize("env_id", yaml.safe_load(ZOO.read_text(encoding="utf-8")))
def test_the_settings_for_rl_zoo_make_a_learner(env_id):
    """As RL Zoo reads them: schedules and keyword arguments as text, its own keys apart."""
    PPO = pytest.importorskip("stable_baselines3").PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    settings = yaml.safe_load(ZOO.read_text(encoding="utf-8"))[env_id]
    for own in ("normalize", "n_envs", "n_timesteps"):
        assert settings.pop(own) > 0
    settings["policy_kwargs"] = eval(settings["policy_kwargs"])
    kind, _, rate = settings["learning_rate"].partition("_")
    assert kind == "lin"
    settings["learning_rate"] = float(rate)
    settings["batch_size"] = 64  # of one environment, not sixteen
    assert set(settings) <= set(signature(PPO).parameters)
    envs = DummyVecEnv([lambda: gymnasium.make(env_id, engine="mujoco")])
    model = PPO(env=VecNormalize(envs, gamma=settings["gamma"]), device="cpu", **settings)
    model.learn(settings["n_steps"])
    assert model.num_timesteps == settings["n_steps"]
