"""Random closures, and decisions that last."""

import gymnasium
import numpy as np
import pytest

from agents.exploration import DIGIT, OPEN, OPPOSITION, RandomClosures
from agents.tasks import ActionRepeat, make_task
from hpac_gym.model import SERVO_INDEX

CMC = SERVO_INDEX["thumb_cmc"]
NONE = np.zeros(5, dtype=bool)


def closures(action_repeat: int = 1) -> RandomClosures:
    return RandomClosures(5, action_repeat, np.random.default_rng(0))


def test_a_closure_goes_from_open_to_its_goal_and_stays():
    source = closures()
    way = np.array([source.actions(NONE) for _ in range(40)])
    digits = np.delete(way, CMC, axis=2)
    assert np.all(np.diff(digits, axis=0) >= -1e-6)
    assert digits[0].max() < 0.0
    np.testing.assert_array_equal(way[-1], way[-10])
    assert np.all((digits[-1] >= DIGIT[0] - 1e-6) & (digits[-1] <= DIGIT[1]))
    assert np.all((way[:, :, CMC] >= OPPOSITION[0]) & (way[:, :, CMC] <= OPPOSITION[1]))
    assert np.ptp(way[:, :, CMC], axis=0).max() == 0.0


def test_a_longer_decision_takes_a_closure_farther():
    slow, fast = closures(1), closures(4)
    for _ in range(4):
        stepped = slow.actions(NONE)
    np.testing.assert_allclose(stepped, fast.actions(NONE))


def test_an_ended_episode_gets_a_new_closure_and_the_others_keep_theirs():
    source = closures()
    for _ in range(40):
        before = source.actions(NONE)
    ended = NONE.copy()
    ended[2] = True
    after = source.actions(ended)
    np.testing.assert_array_equal(np.delete(after, 2, axis=0), np.delete(before, 2, axis=0))
    assert after[2, 1:CMC].max() < before[2, 1:CMC].min()
    assert after[2, 1:CMC].min() >= OPEN


def test_a_closure_begins_and_lets_go_when_it_is_told():
    source = RandomClosures(5, 1, np.random.default_rng(0), begin=(20, 30), release=(60, 70))
    way = np.delete(np.array([source.actions(NONE) for _ in range(80)]), [CMC, SERVO_INDEX["thumb_mp"]], axis=2)
    assert np.all(way[:20] == OPEN)
    assert np.all(way[55] > OPEN)
    assert np.all(way[70:] == OPEN)


class Counting(gymnasium.Env):
    """Three control steps, reward 1 each."""

    observation_space = gymnasium.spaces.Box(0, 10, (1,))
    action_space = gymnasium.spaces.Box(-1, 1, (6,))

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return np.zeros(1, np.float32), {}

    def step(self, action):
        self.steps += 1
        return np.full(1, self.steps, np.float32), 1.0, self.steps == 3, False, {"reward_terms": {"one": 1.0}}


def test_a_repeated_action_adds_up_rewards_and_terms_and_ends_with_the_episode():
    env = ActionRepeat(Counting(), 2)
    env.reset()
    observation, reward, terminated, _, info = env.step(np.zeros(6))
    assert (observation[0], reward, terminated, info["reward_terms"]) == (2, 2.0, False, {"one": 2.0})
    observation, reward, terminated, _, info = env.step(np.zeros(6))
    assert (observation[0], reward, terminated, info["reward_terms"]) == (3, 1.0, True, {"one": 1.0})


@pytest.mark.slow
def test_random_closures_hold_what_white_noise_drops():
    """The reason for them: over the same 40 episodes random closures hold more than twice as many."""
    env = make_task("HPAC-Grasp-v0")

    def held(act) -> int:
        wins = 0
        for seed in range(40):
            env.reset(seed=seed)
            over, first = False, True
            while not over:
                *_, terminated, truncated, info = env.step(act(first))
                over, first = terminated or truncated, False
            wins += info["is_success"]
        return wins

    source, rng = RandomClosures(1, 1, np.random.default_rng(0)), np.random.default_rng(0)
    closed = held(lambda first: source.actions(np.array([first]))[0])
    noise = held(lambda first: rng.uniform(-1, 1, 6).astype(np.float32))
    env.close()
    assert closed > 2 * noise
