"""Each example runs in a folder of its own, without the checkout, and what it writes is a policy."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import gymnasium
import pytest

import hpac_gym
from hpac_gym.policies.loading import load_policy

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
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


@pytest.mark.parametrize("name", WORDS)
def test_an_example_trains_a_policy_wherever_it_is_copied(name, tmp_path):
    shutil.copy(EXAMPLES / f"{name}.py", tmp_path)
    only_the_package = tmp_path / "package"
    only_the_package.mkdir()
    (only_the_package / "hpac_gym").symlink_to(Path(hpac_gym.__file__).parent)
    env = os.environ | {"PYTHONPATH": str(only_the_package)}
    line = [sys.executable, f"{name}.py", "--out", "run", *WORDS[name]]
    done = subprocess.run(line, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    written = tmp_path / "run" / WRITES[name]
    assert done.stdout.splitlines()[-1] == str(written.relative_to(tmp_path))
    with gymnasium.make("hpac_gym:HPAC-Grasp-v0", engine="mujoco") as env:
        action, _ = load_policy(str(written), env).predict(env.reset(seed=0)[0])
        assert action in env.action_space
