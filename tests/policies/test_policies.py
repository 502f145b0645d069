"""Learned policies and baselines: when they decide, and how they are found."""

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.errors import ShapeError
from hpac_gym.policies import LearnedPolicy, read_policy
from hpac_gym.policies.loading import about, load_policy
from tests.policies.episodes import actions_of
from tests.processes import python

TINY = "tests.tiny_task:Tiny-v0"


def test_a_learned_policy_decides_as_often_as_in_its_training():
    policy = LearnedPolicy(lambda observation: observation * 2, action_repeat=3)
    acted = actions_of(policy, [np.array([float(step)]) for step in range(7)])
    assert acted[:, 0].tolist() == [0, 0, 0, 6, 6, 6, 12]
    assert policy.predict(np.array([5.0]))[0] == 10


@pytest.mark.parametrize("name", ["random", "scripted"])
def test_a_baseline_acts_the_same_for_the_same_seed(name, tmp_path, monkeypatch):
    (tmp_path / name).mkdir()  # a folder of that name is not the policy
    monkeypatch.chdir(tmp_path)
    assert about(name) == {}
    env = gymnasium.make(TINY)
    policy = load_policy(name, env)

    def actions(seed: int) -> np.ndarray:
        if name == "random":
            policy.set_random_seed(seed)
        return actions_of(policy, [np.zeros(6, np.float32)] * 5)

    first = actions(3)
    assert first.shape == (5, 6)
    assert np.all(np.abs(first) <= 1)
    assert np.array_equal(first, actions(3))


def test_a_batch_of_environments_is_acted_in_row_by_row_and_each_begins_when_it_does():
    """Environment 1 begins again at its third step."""
    policy = LearnedPolicy(lambda observation: observation * 2, action_repeat=3)
    state = None
    acted = []
    for step in range(5):
        seen = np.array([[float(step)], [10.0 + step]])
        actions, state = policy.predict(seen, state, np.array([False, step == 2]))
        acted.append(actions[:, 0].tolist())
    assert acted == [[0, 20], [0, 20], [0, 24], [6, 24], [6, 24]]


def test_predicting_twice_from_a_state_gives_the_same():
    env = gymnasium.make(TINY)
    baselines = [load_policy(name, env) for name in ("scripted", "random")]
    for policy in (*baselines, LearnedPolicy(lambda seen: seen, 2)):
        _, state = policy.predict(np.zeros(6, np.float32))
        (first, _), (again, _) = (policy.predict(np.ones(6), state) for _ in range(2))
        assert np.array_equal(first, again)


def test_random_actions_differ_from_row_to_row_and_the_first_row_s_are_those_of_one_environment():
    policy = load_policy("random", gymnasium.make(TINY))
    (rows, _), (alone, _) = (policy.predict(np.zeros(shape)) for shape in ((3, 6), 6))
    assert len(np.unique(rows, axis=0)) == 3
    first = np.random.default_rng([0, 1]).uniform(-1, 1, 6).astype(np.float32)
    np.testing.assert_array_equal([rows[0], alone], [first, first])


def test_a_policy_is_evaluated_by_stable_baselines3_as_a_model_of_its_own():
    """Its own loop over a batch, whose episodes begin at different times."""
    from stable_baselines3.common.evaluation import evaluate_policy

    envs = HandVecEnv("HPAC-Grasp-v0", num_envs=4, engine="mujoco")
    envs.seed(3)
    successes = []

    def count(here, _):
        if here["done"]:
            successes.append(here["info"]["is_success"])

    policy = load_policy("grasp", gymnasium.make("HPAC-Grasp-v0", engine="mujoco"))
    evaluate_policy(policy, envs, n_eval_episodes=12, callback=count, warn=False)
    envs.close()
    assert len(successes) == 12
    assert sum(successes) >= 8, (
        "it holds 90 % of episodes; with a state that is lost it never closes"
    )


@pytest.mark.parametrize("name", ["grasp", "gentle"])
def test_an_observation_of_another_size_or_without_a_number_is_told(name):
    file = read_policy(name)
    policy = LearnedPolicy.of(file)
    size, _ = file.sizes
    for shape in (size - 1, (2, size + 1), (1, 1, size), ()):
        with pytest.raises(ShapeError, match=rf"observation must have shape \(.*{size},?\), not"):
            policy.predict(np.zeros(shape))
    with pytest.raises(ShapeError, match=r"observation\[0\] = nan must be a finite number"):
        policy.predict(np.full(size, np.nan))


def test_a_policy_file_acts_without_simulator_gymnasium_and_torch():
    script = """
import sys
for name in ("pybullet", "gymnasium", "torch", "stable_baselines3"):
    sys.modules[name] = None  # refuses the import
from hpac_gym.policies import LearnedPolicy, read_policy
file = read_policy("grasp")
policy = LearnedPolicy.of(file)
action, _ = policy.predict([0.0] * file.actor.sizes[0])
assert action.shape == (6,) and abs(action).max() <= 1
assert not [name for name in sys.modules if name.startswith(("hpac_gym.physics", "hpac_gym.tasks", "hpac_gym.envs"))]
"""
    done = python("-c", script)
    assert done.returncode == 0, done.stderr
