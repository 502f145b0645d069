"""The comparison on the gentle task: the teacher's rule, and how policies are judged."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from agents import RunError, gentle
from agents.gentle import Hands
from agents.gentle_rule import LARGEST, RULE
from experiments import gentle as experiment
from experiments.gentle import Feeling, episodes_of, fitted, judge, summary
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.model import synergy_from_action
from hpac_gym.policies import read_policy
from hpac_gym.tasks.task import open_hand


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


def test_an_action_of_one_is_the_largest_increment():
    env = Hands(2, "load")
    env.reset()
    env.step(np.full((2, 6), 9.0))
    limit = open_hand(1.2) + LARGEST
    assert synergy_from_action(env.recent.action) == pytest.approx(np.tile(limit, (2, 1)))
    env.close()


def test_the_teacher_holds_more_than_a_hand_that_stays_open():
    env = Hands(16, "load")
    taught = episodes_of(env, env.taught, 0)
    still = episodes_of(env, lambda: np.zeros((16, 6)), 0)
    felt = episodes_of(env, Feeling(env, fitted(env), True), 0)
    env.close()
    assert taught["success"].mean() > 0.3
    assert not still["success"].any()
    assert 0 < felt["success"].sum() < taught["success"].sum()
    cells = summary(taught)
    assert cells["all"]["successes"] == taught["success"].sum()
    groups = ("2.5 to 3 N", "3 to 4 N", "4 to 5 N")
    assert sum(cells[group]["episodes"] for group in groups) == 16
    assert cells["crushed"] == taught["crushed"].mean()


def test_the_share_that_closures_crush_is_not_told_since_it_is_not_measured(monkeypatch):
    outcomes = (np.ones((8, 2), bool), np.linspace(2.5, 5, 8))
    monkeypatch.setattr(experiment, "closure_outcomes", lambda *_: outcomes)
    for cells in experiment.closures(2, 8).values():
        assert cells["all"]["success_rate"] == 1.0
        assert "crushed" not in cells


def test_rows_count_the_episodes_that_are_asked_for(monkeypatch):
    many = np.zeros(experiment.WORLDS, bool)
    monkeypatch.setattr(experiment, "Hands", lambda *_: Hands(2, "load"))
    monkeypatch.setattr(experiment, "fitted", lambda _: None)
    monkeypatch.setattr(
        experiment,
        "episodes_of",
        lambda *_: {"limit": many + 3.5, "success": many, "crushed": many},
    )
    assert experiment.rows(100, "light", True)["teacher"]["all"]["episodes"] == 100


def test_a_policy_is_trained_written_and_judged(tmp_path, monkeypatch):
    monkeypatch.setattr(gentle, "WORLDS", 4)
    monkeypatch.setattr(gentle, "UPDATES", 10)
    monkeypatch.setattr(gentle, "WARMING", 1)
    words = ["--out", str(tmp_path), "--rounds", "2", "--steps", str(4 * 88 * 2 - 9), "--untold"]
    gentle.main(words)
    name = str(tmp_path / "policy.hpac")
    about = read_policy(name).about
    assert (about["obs"], about["control_steps"]) == ("load", 4 * 88 * 4)
    assert about["episodes"] >= 4 * 4, "none lasts longer"
    with pytest.raises(RunError, match=r"policy\.hpac' is there already"):
        gentle.main(words)
    found = judge(name, HELD_OUT_SEED, 4, engine="mujoco", told=False)
    assert found["all"]["episodes"] == 4
