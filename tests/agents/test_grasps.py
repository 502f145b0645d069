"""The grasp benchmark's command: numbers, table, files, errors."""

import json

import pytest
from PIL import Image

from agents.grasps import Row, Trial, benchmark, main, table
from agents.statistics import wilson_interval
from hpac_gym.envs import GraspError
from hpac_gym.errors import HpacError

TRIALS = (Trial(1, True, "hold", 20.0), Trial(2, True, "hold", 30.0), Trial(3, False, "lift", None), Trial(4, False, "hold", 5.0))


def test_a_row_sums_up_its_trials():
    numbers = Row("rod", "scripted", TRIALS).summary()
    assert (numbers["episodes"], numbers["successes"]) == (4, 2)
    assert numbers["interval_95"] == list(wilson_interval(2, 4))
    assert numbers["hold_force_newton"] == 25.0, "a grasp that failed in the end has no part in the hold force"
    assert numbers["drops_by_phase"] == {"lift": 1, "hold": 1}


def test_the_table_has_a_line_for_each_row_and_no_force_without_success():
    lines = table([Row("rod", "scripted", TRIALS), Row("rod", "random", TRIALS[2:])]).splitlines()
    assert len(lines) == 4
    assert "| 50% |" in lines[2]
    assert "| – |" in lines[3]


def test_an_episode_depends_on_its_seed_alone():
    whole = benchmark(["scripted"], ["lateral_pinch"], 3, seed_start=7)[0].trials
    last = benchmark(["scripted"], ["lateral_pinch"], 1, seed_start=9)[0].trials
    assert whole[2:] == last


def test_the_command_writes_numbers_pictures_and_a_sheet(tmp_path, capsys):
    options = ["--grasps", "small_cylinder", "press", "--episodes", "2", "--workers", "1", "--json", "--out", str(tmp_path)]
    assert main(options) == 0
    printed = json.loads(capsys.readouterr().out)
    assert [(row["grasp"], row["policy"]) for row in printed["grasps"]] == [
        ("small_cylinder", "scripted"),
        ("small_cylinder", "random"),
        ("press", "scripted"),
        ("press", "random"),
    ]
    written = json.loads((tmp_path / "grasps.json").read_text())
    assert len(written["trials"]["press/scripted"]) == 2
    sheet, single = Image.open(tmp_path / "contact_sheet.png"), Image.open(tmp_path / "press.png")
    assert (sheet.width, sheet.height) == (4 * single.width, single.height)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--grasps", "rods"], GraspError),
        (["--grasps", "rod", "--variant", "huge"], GraspError),
        (["--grasps", "rod", "--policy", "/no/such/policy.zip"], HpacError),
    ],
)
def test_a_mistake_is_named_before_anything_runs(options, error):
    with pytest.raises(error):
        main([*options, "--episodes", "1", "--workers", "1"])
