"""The grasp benchmark: what it counts, and how it is told."""

from hpac_gym.envs import GRASPS
from hpac_gym.evaluation.grasps import Row, Trial, benchmark, table
from hpac_gym.evaluation.statistics import wilson_interval

TRIALS = (
    Trial(1, True, "place", 20.0),
    Trial(2, True, "place", 30.0),
    Trial(3, False, "lift", None),
    Trial(4, False, "place", 5.0),
)


def test_a_row_sums_up_its_trials():
    numbers = Row("rod", "scripted", TRIALS).summary()
    assert (numbers["episodes"], numbers["successes"]) == (4, 2)
    assert numbers["interval_95"] == list(wilson_interval(2, 4))
    assert numbers["hold_force_newton"] == 25.0, (
        "a grasp that failed in the end has no part in the hold force"
    )
    assert numbers["drops_by_phase"] == {"lift": 1, "place": 1}


def test_the_table_has_a_line_for_each_row_and_no_force_without_success():
    lines = table([Row("rod", "scripted", TRIALS), Row("rod", "random", TRIALS[2:])]).splitlines()
    assert len(lines) == 4
    assert "| 50% |" in lines[2]
    assert "| – |" in lines[3]


def test_a_row_names_the_object_of_its_variant():
    objects = {
        variant: Row("rod", "scripted", TRIALS, variant).summary()["object"]
        for variant in ("nominal", "heavy", "shape")
    }
    assert objects["nominal"] == objects["heavy"] == GRASPS["rod"].object.about
    assert objects["shape"] == GRASPS["rod"].variant("shape").object.about != objects["nominal"]


def test_an_episode_depends_on_its_seed_alone():
    """Nor on the number of processes."""
    whole = benchmark(["scripted"], ["lateral_pinch"], 3, seed_start=7, workers=2)[0].trials
    last = benchmark(["scripted"], ["lateral_pinch"], 1, seed_start=9)[0].trials
    assert whole[2:] == last
