"""`hpac grasps`: numbers, table, pictures, mistakes."""

import json

import pytest
from PIL import Image

from hpac import main
from hpac_gym.envs import GRASPS
from hpac_gym.evaluation.pictures import TITLE
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.policies.policy_file import SHIPPED

TRAINED = SHIPPED["grasp"]


def test_it_writes_numbers_table_pictures_and_a_sheet(tmp_path, capsys):
    words = [
        "--grasps",
        "small_cylinder",
        "press",
        "-n",
        "2",
        "--workers",
        "1",
        "--json",
        "--out",
        str(tmp_path),
    ]
    assert main(["grasps", *words]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["first_seed"] == HELD_OUT_SEED
    assert [(row["grasp"], row["policy"]) for row in printed["grasps"]] == [
        ("small_cylinder", "scripted"),
        ("small_cylinder", "random"),
        ("press", "scripted"),
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
    assert [trial["seed"] for trial in written["trials"]["press/scripted"]] == [
        HELD_OUT_SEED,
        HELD_OUT_SEED + 1,
    ]
    assert len((tmp_path / "grasps.md").read_text().splitlines()) == 6
    sheet = Image.open(tmp_path / "contact_sheet.png")
    single = Image.open(tmp_path / "press.png")
    assert sheet.size == (2 * single.width, single.height + TITLE)


def test_workers_and_a_policy_file_give_the_same_kind_of_result(tmp_path, capsys):
    words = ["--policy", str(TRAINED), "--grasps", "rod", "-n", "1", "--no-baselines"]
    for workers in ("1", "2"):
        assert main(["grasps", *words, "--workers", workers, "--out", str(tmp_path / workers)]) == 0
    first, second = (
        json.loads((tmp_path / workers / "grasps.json").read_text()) for workers in ("1", "2")
    )
    assert first == second
    assert first["policy"]["algorithm"] == "one-step SAC"
    assert (tmp_path / "1" / "rod.png").read_bytes() == (tmp_path / "2" / "rod.png").read_bytes()


@pytest.mark.slow
def test_it_runs_all_sixteen(tmp_path, capsys):
    assert (
        main(["grasps", "-n", "1", "--workers", "2", "--no-baselines", "--out", str(tmp_path)]) == 0
    )
    assert len(capsys.readouterr().out.splitlines()) == 2 + 16
    assert {path.stem for path in tmp_path.glob("*.png")} == {*GRASPS, "contact_sheet"}
