"""Film strips of episodes."""

import gymnasium
import numpy as np
import pytest
from PIL import Image

from hpac_gym.policies.loading import load_policy
from tools.film_strip import BORDER, CAPTION, FRAME, TITLE, Row, caption, film_strip, main, sheet


def test_the_command_draws_a_row_an_episode_and_a_picture_a_time(tmp_path, capsys):
    out = tmp_path / "strip.png"
    words = ["HPAC-Posture-v1", "--seeds", "7", "9", "--at", "0.05", "0.1", "0.2"]
    main([*words, "--out", str(out)])
    with Image.open(out) as strip:
        assert strip.size == (
            4 * (FRAME[0] + BORDER) - BORDER,  # the goal, and a picture each time
            2 * (TITLE + CAPTION + FRAME[1] + BORDER) - BORDER,
        )
    assert str(out) in capsys.readouterr().out


def strip(env_id: str, seed: int, *times: float, policy: str = "scripted") -> Row:
    with gymnasium.make(env_id, engine="mujoco", render_mode="rgb_array") as env:
        return film_strip(env, load_policy(policy, env), seed, times)


def test_a_row_of_postures_begins_with_its_goal_and_tells_the_error():
    row = strip("HPAC-Posture-v1", 7, 0.1, 2.0)
    goal, start, end = (np.asarray(picture, float)[CAPTION:] for picture in row.pictures)
    assert np.abs(goal - end).mean() < np.abs(goal - start).mean() / 3
    assert row.success
    assert row.title.startswith("bring fifteen joints to the goal: success, largest error 0.0")


def test_a_failure_ends_its_row_with_the_end_and_says_why():
    row = strip("HPAC-GraspAny-v1", 1_000_009, 0.05, 1.5, 3.5)
    assert not row.success
    assert row.title.endswith("failure, pushed away while the hand closed")
    assert len(row.pictures) == 2
    row = strip("HPAC-GraspAny-v1", 1_000_002, 0.05, 3.5)
    assert row.title.endswith("failure, the hand closed beside it")


def test_the_camera_stands_still_so_that_a_lift_is_seen():
    """The hand is dark and white in a bright room: its pixels move up."""
    row = strip("HPAC-Grasp-v0", 1_000_000, 1.15, 1.75)
    heights = []
    for picture in row.pictures:
        pixels = np.asarray(picture.convert("HSV"), int)[CAPTION:]
        orange = (pixels[..., 0] < 25) & (pixels[..., 1] > 180)  # the fingertips
        heights.append(np.flatnonzero(orange.any(1)).mean())
    assert heights[1] < heights[0] - 30


def test_the_colour_of_a_title_tells_a_failure():
    white = Image.new("RGB", (FRAME[0], CAPTION + FRAME[1]), "white")
    drawn = [np.asarray(sheet([Row("words", won, [white])]), int) for won in (True, False)]
    red = [(picture[..., 0] - picture[..., 2]).max() for picture in drawn]
    assert red[0] < 20 < red[1]


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
