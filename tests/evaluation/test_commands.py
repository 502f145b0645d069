"""`hpac grasps`: numbers, table, pictures, mistakes."""

import json
from pathlib import Path

import pytest
from PIL import Image

from hpac import main
from hpac_gym.envs import GRASPS
from hpac_gym.evaluation.pictures import TITLE
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.policies.policy_file import SHIPPED
from tests.options import refused

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


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mistakes")
    (folder / "file").write_text("no policy")
    (folder / "cut.hpac").write_bytes(TRAINED.read_bytes()[:1000])
    return folder


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ("--policy best", "no policy file 'best', and not one of random, scripted, gentle"),
        ("--policy {folder}/file", "is not a policy file (.hpac)"),
        ("--policy {folder}/cut.hpac", "is damaged"),
        ("--policy {folder}", "is not an exported policy"),
        ("--policy ./mine.py:load", "no policy './mine.py:load': "),
        ("--grasps rods", "no grasp 'rods'; there are 16, among them rod"),
        ("--grasps rod --variant huge", "has no variant 'huge'"),
        ("--episodes 0", "'0' is not a whole number of at least 1 (see hpac grasps --help)"),
        ("--workers some", "'some' is not a whole number of at least 1"),
        ("--out {folder}/file/results", "cannot write to folder"),
        ("--out /proc/results", "cannot write to folder '/proc/results'"),
        ("--nonsense", "unrecognized arguments: --nonsense"),
    ],
)
def test_a_mistake_ends_in_one_line_and_status_2_before_anything_runs(
    folder, tmp_path, words, complaint, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    words = words.format(folder=folder).split()
    assert complaint in refused(capsys, lambda: main(["grasps", *words]))
