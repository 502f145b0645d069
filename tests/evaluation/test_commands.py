"""`hpac grasps`: numbers, table, pictures, mistakes."""

import json

import pytest
from PIL import Image

from hpac import main
from hpac_gym.command import USAGE_ERROR
from hpac_gym.envs import GRASPS
from hpac_gym.evaluation.pictures import TITLE
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.physics.engine import PhysicsError


def test_it_writes_numbers_table_pictures_and_a_sheet(tmp_path, capsys):
    words = ["--policy", "grasp", "--grasps", "small_cylinder", "press", "-n", "2", "--json"]
    assert main(["grasps", *words, "--workers", "1", "--out", str(tmp_path)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["first_seed"] == HELD_OUT_SEED
    assert printed["policy"]["algorithm"] == "one-step SAC"
    assert [(row["grasp"], row["policy"]) for row in printed["grasps"]] == [
        ("small_cylinder", "grasp"),
        ("small_cylinder", "random"),
        ("press", "grasp"),
        ("press", "random"),
    ]
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "contact_sheet.png",
        "grasps.json",
        "grasps.md",
        "press.png",
        "small_cylinder.png",
    ]
    written = json.loads((tmp_path / "grasps.json").read_text())
    assert [trial["seed"] for trial in written["trials"]["press/grasp"]] == [
        HELD_OUT_SEED,
        HELD_OUT_SEED + 1,
    ]
    assert len((tmp_path / "grasps.md").read_text().splitlines()) == 6
    sheet = Image.open(tmp_path / "contact_sheet.png")
    single = Image.open(tmp_path / "press.png")
    assert sheet.size == (2 * single.width, single.height + TITLE)


def test_what_was_measured_is_told_where_no_picture_can_be_drawn(tmp_path, capsys, monkeypatch):
    def broken(*_):
        raise PhysicsError("no OpenGL")

    monkeypatch.setattr("hpac_gym.evaluation.pictures.portrait", broken)
    words = ["--grasps", "press", "-n", "1", "--workers", "1", "--out", str(tmp_path)]
    assert main(["grasps", *words]) == USAGE_ERROR
    told = capsys.readouterr()
    assert told.out == (tmp_path / "grasps.md").read_text()
    assert told.err == "error: no OpenGL\n"


@pytest.mark.slow
def test_it_runs_all_sixteen(tmp_path, capsys):
    assert (
        main(["grasps", "-n", "1", "--workers", "2", "--no-baselines", "--out", str(tmp_path)]) == 0
    )
    assert len(capsys.readouterr().out.splitlines()) == 2 + 16
    assert {path.stem for path in tmp_path.glob("*.png")} == {*GRASPS, "contact_sheet"}
