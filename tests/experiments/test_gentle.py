"""The comparison on the gentle task: the teacher's rule, and what its wrapper remembers."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from experiments.gentle import (
    FREE,
    LARGEST,
    OPEN,
    RULE,
    STACK,
    Increments,
    action_of,
    episodes_of,
    summary,
)


def moved(force, synergy=0.8, age=40):
    """Increments of one hand that feels forces of palm and digits, shape (6,) [N]."""
    return RULE.increments(
        np.full((1, 6), synergy),
        np.array([age]),
        np.array([force], float),
        np.array([4.0]),
        np.array([0.05]),
        np.zeros(1),
    )[0]


def test_the_rule_closes_what_feels_nothing_and_opens_what_feels_too_much():
    assert (moved([0.0] * 6)[:5] > 0).all()
    assert (moved([0.0, 9.0, 3.0, 3.0, 2.0, 1.0])[:5] < 0).all()
    part = moved([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
    assert part[0] > 0 > part[1]
    assert moved([0.0] * 6, synergy=0.0)[1] == RULE.fstep
    assert moved([0.0] * 6, synergy=0.0, age=0)[0] == 0.0  # the thumb waits


def test_an_action_is_the_increment_that_the_hand_makes():
    env = Increments(2, "load")
    env.reset()
    move = np.array([[0.01, 0.02, -0.01, 0.1, 0.0, -0.05]] * 2)
    env.step(action_of(move))
    assert env.synergy == pytest.approx(np.maximum(OPEN + move, 0.0))
    env.step(action_of(np.full((2, 6), 9.0)))
    assert env.synergy == pytest.approx(np.maximum(OPEN + move, 0.0) + LARGEST)
    env.close()


def test_an_observation_ends_with_the_newest_and_begins_with_the_mean_of_the_first():
    env = Increments(1, "load")
    seen = [env.reset()]
    for _ in range(FREE + 4):
        seen.append(env.step(np.full((1, 6), 0.2))[0])
    frames = [one.reshape(STACK, -1) for one in seen]
    assert np.array_equal(frames[8][-1], frames[10][-2])
    first = np.mean([frame[-1] for frame in frames[: FREE + 1]], axis=0)
    assert frames[-1][0] == pytest.approx(first, abs=1e-5)
    assert np.array_equal(frames[-1][0], frames[-2][0])
    env.close()


def test_the_teacher_holds_more_than_a_hand_that_stays_open():
    env = Increments(32, "deploy")
    taught = episodes_of(env, lambda seen: env.taught(RULE), 0)
    still = episodes_of(env, lambda seen: np.zeros((32, 6)), 0)
    env.close()
    assert taught["success"].mean() > 0.3
    assert not still["success"].any()
    cells = summary(taught)
    assert cells["all"]["successes"] == taught["success"].sum()
    groups = ("2.5 to 3 N", "3 to 4 N", "4 to 5 N")
    assert sum(cells[group]["episodes"] for group in groups) == 32
