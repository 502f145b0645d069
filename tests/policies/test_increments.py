"""Policies that move the hand by increments: what they see, what they remember, what they may be."""

import numpy as np
import pytest

from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.policies import LearnedPolicy, PolicyError
from hpac_gym.policies.increments import Increments
from hpac_gym.policies.loading import load_policy
from hpac_gym.policies.policy_file import from_description
from hpac_gym.registration import GENTLE
from tests.policies.episodes import actions_of

MOVES = Increments((-1.0,) * 5 + (0.5,), (0.1,) * 6, frames=2, apart=2, first=3)


def test_it_is_shown_the_mean_of_the_first_and_some_of_the_last_observations():
    shown = []

    def actor(entries):
        shown.append(entries.tolist())
        return np.zeros(6, np.float32)

    policy = LearnedPolicy(actor, increments=MOVES)
    state = None
    seen = np.zeros(1)
    for n in range(6):
        seen[:] = n  # in place, as environments do that keep one array
        state = policy.predict(seen, state)[1]
    assert shown == [[0, 0, 0], [0.5, 0, 1], [1, 0, 2], [1, 1, 3], [1, 2, 4], [1, 3, 5]]


def test_a_decision_moves_the_hand_from_where_it_is_by_its_square_within_the_range():
    policy = LearnedPolicy(lambda seen: np.full(6, 0.5, np.float32), increments=MOVES)
    moved = actions_of(policy, [np.zeros(1)] * 3)
    assert moved[:, 0] == pytest.approx([-0.975, -0.95, -0.925])
    back = LearnedPolicy(lambda seen: np.full(6, -1.0, np.float32), increments=MOVES)
    assert actions_of(back, [np.zeros(1)] * 3)[:, 5] == pytest.approx([0.4, 0.3, 0.2])
    assert (actions_of(back, [np.zeros(1)] * 3)[:, 0] == -1.0).all()
    wanted = np.array([[0.03, -0.02, 0.0, 0.1, -0.1, 0.05]])
    decided = MOVES.decisions(wanted)
    assert decided * np.abs(decided) * 0.1 == pytest.approx(wanted)


def test_worlds_begin_when_they_do_and_predicting_twice_gives_the_same():
    policy = LearnedPolicy(lambda seen: np.clip(seen[-6:], -1, 1), increments=MOVES)
    seen = np.random.default_rng(0).uniform(-1, 1, (5, 2, 6))
    state = None
    for step, rows in enumerate(seen):
        actions, following = policy.predict(rows, state, np.array([False, step == 3]))
        assert np.array_equal(policy.predict(rows, state, np.array([False, step == 3]))[0], actions)
        state = following
    alone = actions_of(policy, seen[3:, 1])
    assert np.array_equal(actions[1], alone[-1])
    assert not np.array_equal(actions[1], actions_of(policy, seen[:, 1])[-1])


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({"start": [0.0] * 5, "largest": [0.1] * 6}, "start"),
        ({"start": [0.0] * 6, "largest": [np.nan] * 6}, "largest"),
        ({"start": [0.0] * 6, "largest": [0.1] * 6, "apart": 0}, "apart = 0"),
        ({"start": [0.0] * 6}, "largest"),
        ({"start": [0.0] * 6, "largest": [0.1] * 6, "end": 1}, "end"),
    ],
)
def test_other_numbers_are_refused_in_one_line(told, says):
    with pytest.raises(PolicyError, match=says) as caught:
        from_description(Increments, told)
    assert "\n" not in str(caught.value)


def test_it_needs_what_it_feels_and_the_mean_of_the_first():
    """Without the servos' load, or without what it remembers, it holds fewer."""
    options = {"engine": "mujoco", "body": "light", "obs": "load"}
    whole = evaluate(["gentle"], GENTLE, 20, seed_start=7_000, options=options)
    blind = evaluate([f"{__name__}:blind"], GENTLE, 20, seed_start=7_000, options=options)
    held, without = (
        sum(one.success for one in found.episodes["learned"]) for found in (whole, blind)
    )
    assert held >= 8
    assert held >= without + 5


def blind(env):
    """The shipped policy, whose load entries are those of a hand that has no servos to ask."""
    policy = load_policy("gentle", env)
    where = slice(env.unwrapped.slices["load"].start, None)

    class Blind:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            seen = np.array(observation)
            seen[..., where] = 0.0
            return policy.predict(seen, state, episode_start)

    return Blind()
