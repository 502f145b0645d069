"""The headroom of HPAC-GraspAny-v1: what is counted is what was played."""

import numpy as np

from tools import any_closures
from tools.any_closures import drawn_closure


def test_random_closures_differ_and_stay_in_their_ranges():
    drawn = np.array([drawn_closure(seed, number) for seed in range(20) for number in range(20)])
    low, high = any_closures.CLOSURES.bounds
    values = low + (drawn + 1) / 2 * (high - low)
    assert (values >= any_closures.LOWEST - 1e-9).all()
    assert (values <= any_closures.HIGHEST + 1e-9).all()
    assert len(np.unique(drawn, axis=0)) == 400


def test_the_first_winner_of_each_seed_is_counted(monkeypatch):
    """Here a seed is won by its closure of that number, and seed 7 by none; several of a seed may
    be tried at once.
    """
    tried = []

    def play(seeds, decisions):
        tried.extend(seeds)
        return np.array(
            [
                np.array_equal(row, drawn_closure(s, s)) and s != 7
                for s, row in zip(seeds, decisions, strict=True)
            ]
        )

    monkeypatch.setattr(any_closures, "WORLDS", 16)
    assert any_closures.first_winners(play, range(12), 8) == {seed: seed + 1 for seed in range(7)}
    assert tried.count(9) == 8, "no closure is tried beyond the last one"
