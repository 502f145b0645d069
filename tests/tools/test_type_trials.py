"""Grasp types in physics: the posture, executed, holds the object by the parts that its name asks
for.
"""

from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.model import HPAC
from hpac_gym.tasks.grasp_data import GRASPS
from hpac_gym.tasks.grasp_rules import GRASP_TYPES, GraspType
from tools import grasp_types as judged
from tools.type_trials import TypeTrial, run_types

SEEDS = range(7_000_000, 7_000_008)


def trials(kind: GraspType, count: int, engine: str = "mujoco") -> list[TypeTrial]:
    found = dict(run_types([kind] * count, SEEDS[:count], engine=engine))
    return [found[index] for index in range(count)]


@pytest.mark.parametrize("name", ["hook", "scissors"])
def test_a_type_is_held_as_it_is_called_and_the_frozen_grasp_of_its_name_is_not(name: str):
    """The negative control holds the object, in most episodes, and fails by the rule alone."""
    mine = trials(GRASP_TYPES[name], 4)
    frozen = trials(GraspType(GRASPS[name], GRASP_TYPES[name].rule), 4)
    assert sum(trial.success for trial in mine) >= 2
    assert sum(trial.held for trial in frozen) >= 2
    assert not any(trial.success for trial in frozen)


def test_an_open_hand_is_no_grasp_and_a_start_in_touch_is_none():
    kind = GRASP_TYPES["hook"]
    open_hand = replace(kind, start=replace(kind.start, closed=np.zeros(6)))
    assert not any(trial.held or trial.success for trial in trials(open_hand, 2))
    closed = replace(kind, start=replace(kind.start, preshape=HPAC.synergy_max * 0.7))
    assert not any(trial.free or trial.success for trial in trials(closed, 2))


@pytest.mark.parametrize("name", GRASP_TYPES)
def test_the_results_on_the_page_were_taken_on_the_data_that_is_here(name: str):
    found = judged.results()[name]
    assert found["data"] == judged.fingerprint(name), (
        f"run python -m tools.grasp_types --types {name}"
    )
    for hand in judged.HANDS:
        assert set(found[hand]) == set(judged.SET_UPS)
        assert all(
            0 <= row["successes"] <= row["held"] <= row["episodes"] for row in found[hand].values()
        )


@pytest.mark.slow
@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
@pytest.mark.parametrize("name", GRASP_TYPES)
def test_a_type_does_as_well_as_its_page_says(name: str, engine: str):
    """On eight other seeds; a rate that lies below the page's by more than chance, one in a
    thousand, is red.
    """
    row = judged.results()[name]["nominal"][f"{engine}/twin"]
    wins = sum(trial.success for trial in trials(GRASP_TYPES[name], len(SEEDS), engine))
    rate = (row["successes"] + 1) / (row["episodes"] + 2)
    spread = np.sqrt(rate * (1 - rate) * (1 / len(SEEDS) + 1 / row["episodes"]))
    assert wins / len(SEEDS) >= rate - 3.1 * spread
