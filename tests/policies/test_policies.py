"""Learned policies and baselines: when they decide, and how they are found."""

import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from hpac_gym.policies import LearnedPolicy, PolicyError
from hpac_gym.policies.loading import load_policy

ROOT = Path(__file__).resolve().parents[2]
TINY = "tests.tiny_task:Tiny-v0"


def test_a_learned_policy_decides_as_often_as_in_its_training():
    policy = LearnedPolicy(lambda observation: observation * 2, action_repeat=3)
    policy.reset(0)
    acted = [policy.act(np.array([float(step)]))[0] for step in range(7)]
    assert acted == [0, 0, 0, 6, 6, 6, 12]
    policy.reset(0)
    assert policy.act(np.array([5.0]))[0] == 10


@pytest.mark.parametrize("name", ["random", "scripted"])
def test_a_baseline_acts_the_same_for_the_same_seed(name):
    env = gymnasium.make(TINY)
    policy = load_policy(name, env)

    def actions(seed: int) -> np.ndarray:
        policy.reset(seed)
        return np.array([policy.act(np.zeros(6, np.float32)) for _ in range(5)])

    first = actions(3)
    assert first.shape == (5, 6)
    assert np.all(np.abs(first) <= 1)
    assert np.array_equal(first, actions(3))


def test_a_name_that_is_no_policy_is_told_with_those_that_are():
    with pytest.raises(
        PolicyError, match="no policy file 'best', and not one of random, scripted, grasp"
    ):
        load_policy("best", gymnasium.make(TINY))


def test_a_policy_file_acts_without_simulator_gymnasium_and_torch():
    script = """
import sys
for name in ("pybullet", "gymnasium", "torch", "stable_baselines3"):
    sys.modules[name] = None  # refuses the import
from hpac_gym.policies import LearnedPolicy, read_policy
file = read_policy("grasp")
policy = LearnedPolicy.of(file)
policy.reset(seed=0)
action = policy.act([0.0] * file.actor.sizes[0])
assert action.shape == (6,) and abs(action).max() <= 1
assert not [name for name in sys.modules if name.startswith(("hpac_gym.physics", "hpac_gym.tasks", "hpac_gym.envs"))]
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
