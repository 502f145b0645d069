"""HPAC-Posture-v1: goals, rewards, and hindsight replay."""

from dataclasses import replace
from itertools import islice

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs import GoalEnv, Posture
from hpac_gym.errors import ShapeError
from hpac_gym.evaluation.evaluate import run_block
from hpac_gym.model import HPAC, JOINTS, joints_from_synergy, synergy_from_joints
from hpac_gym.model.calibration import Calibration
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.tasks import posture
from hpac_gym.tasks.posture import CAMERA_NOISE, TOLERANCE, ScriptedPosture
from tests.envs.episodes import run, steps

ID = "HPAC-Posture-v1"


@pytest.fixture
def env():
    with gymnasium.make(ID, randomize="nominal") as made:
        yield made


OBVIOUS = ScriptedPosture(near=0.0)
"""Asks for the goal's own synergy."""


def test_goals_lie_on_the_manifold_of_the_hand(env):
    for seed in range(20):
        goal = env.reset(seed=seed)[0]["desired_goal"]
        np.testing.assert_allclose(joints_from_synergy(synergy_from_joints(goal)), goal, atol=1e-6)


UNREACHABLE = (1000003, 1000010, 1000020, 1000052)
"""Seeds whose first draw lets the thumb meet the index finger."""


def reached(env: gymnasium.Env, seed: int) -> bool:
    """Whether the obvious action reaches the goal of a seed."""
    infos, _ = run(env, OBVIOUS, seed=seed)
    return infos[-1]["is_success"]


def test_no_goal_is_drawn_that_the_index_finger_blocks(monkeypatch):
    with gymnasium.make(ID, engine="mujoco", randomize="nominal") as env:
        assert all(reached(env, seed) for seed in UNREACHABLE)
        monkeypatch.setattr(posture, "BLOCKED_MP", np.inf)
        assert not any(reached(env, seed) for seed in UNREACHABLE)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("count", [10, pytest.param(200, marks=pytest.mark.slow)])
def test_the_obvious_action_reaches_every_goal(engine, count):
    with gymnasium.make(ID, engine=engine, randomize="nominal") as env:
        assert all(reached(env, seed) for seed in range(count))


def test_an_integral_controller_passes_the_constant_action_where_the_hand_is_another_one():
    """What the page's table says, with fewer episodes."""
    policies = ["scripted", "hpac_gym.policies.baselines:constant_posture"]
    played = run_block(policies, ID, {"engine": "mujoco"}, range(7000, 7024))
    integral, constant = (
        np.mean([one.success for one in each]) for each in zip(*played, strict=True)
    )
    assert integral > 0.8
    assert constant < 0.1


def test_it_has_a_hand_of_its_own_in_every_episode():
    with gymnasium.make(ID) as env:
        drawn = {"tendon_stiffness", "slack", "joint_friction", "skin_friction"}
        assert set(env.reset(seed=0)[1]["randomized"]) == drawn


def test_compute_reward_is_vectorised_and_what_step_returns():
    for reward in ("dense", "sparse"):
        with gymnasium.make(ID, reward=reward, randomize="nominal") as env:
            rows, rewards, *_ = zip(*islice(steps(env, OBVIOUS), 1, 31), strict=True)
            achieved, desired = (
                np.array([row[name] for row in rows]) for name in ("achieved_goal", "desired_goal")
            )
            np.testing.assert_array_equal(
                env.unwrapped.compute_reward(achieved, desired, None), rewards
            )
            assert env.unwrapped.compute_reward(
                achieved.reshape(3, 10, -1), desired.reshape(3, 10, -1), {}
            ).shape == (3, 10)
    assert rewards[0] == -1.0
    assert rewards[-1] == 0.0


def test_a_subclass_pays_what_it_computes_for_hindsight_replay(opened):
    class Tenfold(Posture):
        def goal_reward(self, achieved, desired, dense):
            return 10 * super().goal_reward(achieved, desired, dense)

    for reward in ("dense", "sparse"):
        env = opened(GoalEnv(Tenfold(), reward=reward))
        env.reset(seed=0)
        row, paid, *_ = env.step(np.zeros(6))
        assert paid == env.compute_reward(row["achieved_goal"], row["desired_goal"], {}) < -1.0


def test_sparse_reward_is_zero_within_the_tolerance_of_every_joint(opened):
    env = opened(GoalEnv(Posture(), reward="sparse"))
    achieved = np.zeros((4, len(JOINTS)))
    achieved[:, 3] = 0, 0.99 * TOLERANCE, 1.01 * TOLERANCE, np.nan
    paid = env.compute_reward(achieved, np.zeros(len(JOINTS)), {})
    np.testing.assert_array_equal(paid, [0, 0, -1, -1])
    with pytest.raises(
        ShapeError, match=r"achieved_goal must have shape \(\.\.\., 15\), not \(4, 14"
    ):
        env.compute_reward(np.zeros((4, 14)), np.ones((4, 14)), {})


def test_the_achieved_goal_is_measured_by_a_camera(env):
    observation, _ = env.reset(seed=0)
    env.step(np.zeros(6, np.float32))
    errors = []
    for _ in range(30):
        observation, *_ = env.step(np.zeros(6, np.float32))
        errors.append(observation["achieved_goal"] - env.unwrapped.state.joint_pos[0])
    assert np.std(errors) == pytest.approx(CAMERA_NOISE, rel=0.15)


def test_a_given_goal_is_that_of_the_episode_and_leaves_the_hand_as_it_is():
    hand = replace(HPAC, calibration=Calibration(servo_zero=(0.05,) * 6))
    with gymnasium.make(ID, randomize="nominal", hand=hand) as env:
        for options in (None, {"goal": np.full(15, 0.2)}):
            observation, _ = env.reset(seed=0, options=options)
            (setup,) = env.unwrapped.episodes.setups
            assert setup.hand_settings.servo_zero == (0.05,) * 6
    np.testing.assert_allclose(observation["desired_goal"], 0.2, atol=1e-6)


def test_only_the_time_limit_ends_an_episode_and_the_goals_say_so_too(env):
    goals = env.unwrapped
    batch = np.zeros((3, 10, len(JOINTS)))
    for end in (goals.compute_terminated, goals.compute_truncated):
        assert end(batch[0, 0], batch[0, 0], {}) == False  # noqa: E712  a NumPy boolean, reached or not
        ends = np.zeros((3, 10), bool)
        np.testing.assert_array_equal(end(batch, batch[0, 0] + 1, {}), ends, strict=True)
