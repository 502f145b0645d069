"""The notebook and the files of examples/ do what they say."""

import json
import subprocess
import sys
from inspect import signature
from pathlib import Path

import gymnasium
import pytest
import yaml

import hpac_gym  # noqa: F401  registers the environments

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = ROOT / "examples" / "quickstart.ipynb"
ZOO = ROOT / "examples" / "rl_zoo3_ppo.yml"


def test_the_notebook_runs_and_holds_no_outputs(tmp_path):
    cells = [
        cell
        for cell in json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == "code"
    ]
    assert not any(cell["outputs"] for cell in cells)
    program = "\n".join("".join(cell["source"]) for cell in cells)
    done = subprocess.run(
        [sys.executable, "-c", f"import matplotlib; matplotlib.use('agg')\n{program}"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
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
