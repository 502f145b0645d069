"""Every generated file is committed as its generator writes it."""

import pytest

from hpac_gym.body.geometry import load_geometry
from hpac_gym.model import FINGERS
from tools import generate
from tools.thumb_search import find_opposition


def test_the_committed_files_are_what_their_generators_write_and_every_model_file_has_one():
    files = generate.generated()
    assert not [path.name for path, text in files.items() if generate.is_stale(path, text)], (
        "run make generate"
    )
    committed = {path for path in (generate.ROOT / "assets").rglob("*") if path.is_file()}
    assert committed == {path for path in files if "assets" in path.parts}


def test_a_stale_file_is_named_by_check_and_written_without_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(generate, "ROOT", tmp_path)
    path = tmp_path / "assets" / "hand.urdf"
    monkeypatch.setattr(generate, "generated", lambda: {path: "<mass value='0.1' />"})
    assert generate.main(["--check"]) == 1
    assert "assets/hand.urdf: out of date" in capsys.readouterr().out
    assert not path.exists()
    assert generate.main([]) == 0
    assert generate.main(["--check"]) == 0


@pytest.mark.parametrize(
    ("text", "stale"),
    [
        ("mass 0.10000001", True),
        ("mass 0.1000000000001", False),
        ("size 0.1", True),
        ("mass 0.1 0.1", True),
    ],
)
def test_only_a_difference_beyond_the_eighth_digit_of_a_model_is_left_alone(tmp_path, text, stale):
    model = tmp_path / "hand.urdf"
    page = tmp_path / "page.md"
    for path in (model, page):
        path.write_text("mass 0.1", encoding="utf-8")
    assert generate.is_stale(model, text) is stale
    assert generate.is_stale(page, text)


@pytest.mark.parametrize("finger", FINGERS)
def test_the_opposition_postures_are_those_that_the_search_finds(finger):
    geometry = load_geometry()
    assert find_opposition(geometry, finger) == pytest.approx(geometry.opposition[finger], abs=2e-3)
