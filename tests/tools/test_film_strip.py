"""Film strips of episodes."""

import gymnasium
import pytest
from PIL import Image

import hpac_gym  # noqa: F401  registers the environments
from tools.film_strip import BORDER, CAPTION, FRAME, StraightToGoal, caption, main


def test_the_command_draws_a_row_an_episode_and_a_picture_a_time(tmp_path, capsys):
    out = tmp_path / "strip.png"
    assert (
        main(
            [
                "HPAC-Posture-v1",
                "--seeds",
                "7",
                "9",
                "--at",
                "0.05",
                "0.1",
                "0.2",
                "--out",
                str(out),
            ]
        )
        == 0
    )
    with Image.open(out) as strip:
        assert strip.size == (
            3 * (FRAME[0] + BORDER) - BORDER,
            2 * (FRAME[1] + CAPTION + BORDER) - BORDER,
        )
    assert str(out) in capsys.readouterr().out


def test_no_time_within_the_episodes_is_one_line_and_no_picture(tmp_path, capsys):
    out = tmp_path / "strip.png"
    assert main(["HPAC-Grasp-v0", "--policy", "random", "--at", "9", "--out", str(out)]) == 2
    assert not out.exists()
    assert "9" in capsys.readouterr().err


def test_going_straight_to_a_goal_of_the_fingers_reaches_it():
    with gymnasium.make("HPAC-Posture-v1", randomize="nominal") as env:
        policy = StraightToGoal()
        truncated = False
        (observation, _) = env.reset(seed=7)
        while not truncated:
            observation, _, _, truncated, info = env.step(policy.predict(observation)[0])
    assert info["is_success"]


@pytest.mark.parametrize(
    ("info", "words"),
    [
        ({"phase": "lift", "outcome": "running"}, "1.75 s, lift"),
        ({"phase": "hold", "outcome": "success"}, "1.75 s, success"),
        ({"largest_error": 0.123}, "1.75 s, largest error 0.12 rad"),
    ],
)
def test_a_caption_tells_the_time_and_what_info_says(info, words):
    assert caption(1.75, info) == words
