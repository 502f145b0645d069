"""`HandVecEnv` against Stable-Baselines3's own `DummyVecEnv`, to the bit."""

import json
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO, SAC, HerReplayBuffer
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

from hpac_gym.envs.randomization import PRESETS
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.errors import ParameterError
from hpac_gym.registration import GRASP, POSTURE
from hpac_gym.tasks.task import CONTROL_HZ
from tests.envs.episodes import EASY


@pytest.fixture
def pair(opened):
    """Makes three environments of each kind."""

    def make(name: str, **options) -> tuple[HandVecEnv, DummyVecEnv]:
        options = options | {"engine": "mujoco"}
        single = [partial(gymnasium.make, name, **options)] * 3
        return opened(HandVecEnv(name, 3, **options)), opened(DummyVecEnv(single))

    return make


def actions(steps: int, num_envs: int = 3) -> np.ndarray:
    """One hand stays open and loses nothing in time, the others flail."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (steps, num_envs, 6)).astype(np.float32)
    drawn[:, 0] = 0.1 * drawn[:, 0] - 0.9
    return drawn


@pytest.mark.parametrize(
    ("name", "options", "steps"),
    [
        (GRASP, {"randomize": "full"}, 70),
        (GRASP, {"max_episode_steps": 5}, 12),
        (POSTURE, {"max_episode_steps": 7}, 16),
        pytest.param(GRASP, {"obs": "image", "max_episode_steps": 2}, 3, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_everything_that_a_learner_reads_is_as_in_dummy_vec_env(name, options, steps, pair):
    ours, its = pair(name, **options)
    assert (ours.observation_space, ours.action_space) == (its.observation_space, its.action_space)
    for venv in (ours, its):
        venv.seed(7)
    np.testing.assert_equal(ours.reset(), its.reset())
    np.testing.assert_equal(_plain(ours.reset_infos), _plain(its.reset_infos))
    ended = truncated = 0
    for action in actions(steps):
        (seen, rewards, dones, infos) = ours.step(action)
        expected = its.step(action)
        np.testing.assert_equal(seen, expected[0])
        for one, other in ((rewards, expected[1]), (dones, expected[2])):
            np.testing.assert_array_equal(one, other, strict=True)
        for info, other, done in zip(infos, expected[3], dones, strict=True):
            assert info["TimeLimit.truncated"] == other["TimeLimit.truncated"]
            if done:
                np.testing.assert_equal(_plain(info), _plain(other))
                ended = ended + 1
                truncated = truncated + info["TimeLimit.truncated"]
            else:
                assert set(info) == {"TimeLimit.truncated"}
        np.testing.assert_equal(_plain(ours.reset_infos), _plain(its.reset_infos))
    assert ended >= 3
    assert (truncated > 0) == ("max_episode_steps" in options)


def _plain(value):
    """Lists for arrays, since a vector environment stacks what a single one gives as a list."""
    return json.loads(json.dumps(value, default=lambda array: array.tolist()))


def test_attributes_and_methods_reach_the_environments_that_are_named(opened):
    envs = opened(HandVecEnv(GRASP, 3, engine="mujoco"))
    assert envs.metadata["render_fps"] == CONTROL_HZ  # of the films of VecVideoRecorder
    assert envs.get_attr("obs") == ["deploy"] * 3
    with gymnasium.make(GRASP, engine="mujoco") as env:
        assert envs.get_attr("slices") == [env.unwrapped.slices] * 3
    assert envs.has_attr("task")
    assert not envs.has_attr("nonsense")
    envs.set_attr("randomization", "full", indices=[0, 2])
    assert envs.get_attr("randomization") == [PRESETS["full"], PRESETS["nominal"], PRESETS["full"]]
    envs.reset()
    assert [bool(info.get("randomized")) for info in envs.reset_infos] == [True, False, True]
    for call, error, told in (
        (lambda: envs.set_attr("foo", 1), AttributeError, "'foo' is not one of randomization"),
        (lambda: envs.set_attr("foo", 1, 1), AttributeError, "'foo' is not one of randomization"),
        (lambda: envs.env_method("reset"), AttributeError, "'reset' is not one of render, action"),
        (lambda: envs.envs.set_attr("randomization", ["full"] * 2), ParameterError, "2 values"),
    ):
        with pytest.raises(error, match=told):
            call()
    assert envs.env_method("render") == [None] * 3
    envs.set_options([{"setup": None}, {}, {}])
    with pytest.raises(ParameterError, match="with the same names; given: none; setup"):
        envs.reset()
    assert envs.env_is_wrapped(gymnasium.Wrapper) == [False] * 3
    assert envs.get_images() == [None] * 3


@pytest.mark.pybullet
def test_on_pybullet_an_unknown_attribute_ends_no_process_and_options_are_the_same_for_all(opened):
    envs = opened(HandVecEnv(POSTURE, 2, engine="pybullet", randomize="nominal"))
    assert not envs.has_attr("nonsense")
    with pytest.raises(AttributeError, match=r"set_attr: 'foo' is not one of randomization"):
        envs.set_attr("foo", 1)
    with pytest.raises(ParameterError, match="randomize must be a preset"):
        envs.set_attr("randomization", "ful")
    envs.set_attr("randomization", "full", indices=[1])
    assert envs.get_attr("randomization") == [PRESETS["nominal"], PRESETS["full"]]
    assert envs.reset()["observation"].shape[0] == 2
    envs.set_options([{"goal": np.zeros(15)}, {"goal": np.zeros(15)}])
    with pytest.raises(ParameterError, match=r"one for all, .*; given: goal"):
        envs.reset()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (POSTURE, [{"goal": np.full(15, 0.1 * place)} for place in range(3)]),
        (POSTURE, [{"goal": [0.1 * place] * 15} for place in range(3)]),
        (
            GRASP,
            [
                {"setup": replace(EASY, position=EASY.position + 0.005 * place)}
                for place in range(3)
            ],
        ),
    ],
)
def test_options_of_each_environment_are_as_in_dummy_vec_env(name, options, pair):
    ours, its = pair(name)
    for given in (options, options[2]):
        for venv in (ours, its):
            venv.seed(7)
            venv.set_options(given)
        np.testing.assert_equal(ours.reset(), its.reset())


def test_a_learner_of_each_kind_learns_on_it(opened):
    """PPO through the usual wrappers, and hindsight replay, which asks for rewards by
    `env_method`.
    """
    envs = opened(
        VecNormalize(VecMonitor(HandVecEnv(GRASP, 4, engine="mujoco", max_episode_steps=8)))
    )
    learner = PPO("MlpPolicy", envs, n_steps=10, batch_size=10, n_epochs=1, seed=0, device="cpu")
    learner.learn(40)
    assert len(learner.ep_info_buffer) >= 4
    assert len(learner.ep_success_buffer) >= 4
    goals = opened(HandVecEnv(POSTURE, 2, engine="mujoco", max_episode_steps=4))
    replay = SAC(
        "MultiInputPolicy",
        goals,
        replay_buffer_class=HerReplayBuffer,
        learning_starts=10,
        seed=0,
        device="cpu",
    )
    replay.learn(14)
    assert replay.replay_buffer.sample(16).rewards.shape == (16, 1)
