"""The searches of HPAC-GraspAny-v1: what they count is what was played."""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np
import pytest

from hpac_gym.tasks.grasp_any import GraspAny
from hpac_gym.tasks.scripted import ANY_CLOSURES
from tools import any_closures, any_touch
from tools.any_closures import drawn_closure
from tools.any_player import Player
from tools.any_touch import CHOICES, DECIDED, LOOKS, by_policy, chances


def test_random_closures_differ_and_stay_in_their_ranges():
    drawn = np.array([drawn_closure(seed, number) for seed in range(20) for number in range(20)])
    low, high = any_closures.CLOSURES.bounds
    values = low + (drawn + 1) / 2 * (high - low)
    assert (values >= any_closures.LOWEST - 1e-9).all()
    assert (values <= any_closures.HIGHEST + 1e-9).all()
    assert len(np.unique(drawn, axis=0)) == 400


def test_the_first_winner_of_each_seed_is_counted():
    """Here a seed is won by its closure of that number, and seed 7 by none; several of a seed may
    be tried at once.
    """
    tried = []

    def play(seeds, begin):
        decisions = begin.args[0]
        tried.extend(seeds)
        return np.array(
            [
                np.array_equal(row, drawn_closure(s, s)) and s != 7
                for s, row in zip(seeds, decisions, strict=True)
            ]
        )

    player = SimpleNamespace(play=play, count=16)
    assert any_closures.first_winners(player, range(12), 8) == {seed: seed + 1 for seed in range(7)}
    assert tried.count(9) == 8, "no closure is tried beyond the last one"


def test_load_adds_to_deploy_and_privileged_does_not_see_it():
    task = GraspAny()
    seen = np.arange(2 * len(LOOKS) * 155.0).reshape(2, len(LOOKS), 155)
    found = any_touch.arms(seen, task)
    assert found["deploy"].shape == (2, 2 * 46)
    assert found["load"].shape == (2, 2 * 57)
    assert found["privileged"].shape == (2, 2 * 144)
    assert found["privileged"][0, 46] == 57
    assert found["load, memory"].shape == (2, len(LOOKS) * 57)
    np.testing.assert_array_equal(found["load"][0, -57:], seen[0, -1, :57])
    np.testing.assert_array_equal(found["load, memory"][0, 57:114], seen[0, 1, :57])


@pytest.mark.slow
def test_chances_are_learned_where_something_tells_them_and_nowhere_else():
    rng = np.random.default_rng(1)
    seen, asked = rng.standard_normal((2, 320, 20))
    won = np.stack([seen[:, 0] > 0, seen[:, 0] < 0], 1)
    told = chances(seen, won, asked, 0).argmax(1) == (asked[:, 0] < 0)
    assert told.mean() > 0.9
    guessed = chances(seen, rng.random((320, 2)) < 0.5, asked, 0).argmax(1) == (asked[:, 0] < 0)
    assert 0.3 < guessed.mean() < 0.7


def test_the_policy_closes_again_as_at_the_start_of_an_episode_on_what_it_sees_then():
    """Opened in between; the second closure is the first one of an episode whose object is seen
    where it is now.
    """
    task = GraspAny()
    rng = np.random.default_rng(0)
    first, now = rng.uniform(0, 0.5, (2, 3, 155))
    act = any_touch._decided(task, "policy", "again", defaultdict(dict), first, np.arange(3))
    np.testing.assert_array_equal(act(5, now), by_policy(task, first)(5))
    np.testing.assert_array_equal(act(DECIDED, now), np.tile(any_touch.OPEN, (3, 1)))
    moved = first.copy()
    moved[:, 21:40] = now[:, 21:40]  # object_pos to object_seen
    wanted = by_policy(task, moved)
    for step in range(4):
        np.testing.assert_array_equal(
            act(DECIDED + any_touch.OPENING + step, now + step),
            wanted(any_touch.HASTE * step),
        )
    assert np.abs(wanted(20) - by_policy(task, first)(20)).max() > 0.01


@pytest.mark.slow
def test_trials_are_the_same_until_the_decision_and_are_kept(tmp_path):
    player = Player("train", 4)
    trials = any_touch.trials_of(player, "script", range(6), tmp_path)
    assert trials.won.shape == (6, len(CHOICES))
    assert trials.seen.shape[:2] == (6, len(LOOKS))
    assert np.abs(trials.seen[:, 0] - trials.seen[:, -1]).max() > 0.1
    np.testing.assert_array_equal(
        any_closures.play_script(player, range(6), ANY_CLOSURES.__getitem__)[1], trials.won[:, 0]
    )
    player.play = None  # what is kept is not played again
    again = any_touch.trials_of(player, "script", range(6), tmp_path)
    np.testing.assert_array_equal(again.won, trials.won)
    np.testing.assert_array_equal(again.seen, trials.seen)
