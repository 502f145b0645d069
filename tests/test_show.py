"""`hpac show`: a policy in the browser or in a film."""

import json
import signal
import sys
import urllib.request

import numpy as np
import pytest

import hpac
from hpac_gym import progress, show
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.output import OutputError
from hpac_gym.policies.loading import shipped_for
from hpac_gym.view.page import HandPage
from tests.options import refused
from tests.processes import python, started


def test_a_trained_policy_is_shown_on_a_page_until_ctrl_c():
    with started("-m", "hpac", "show", "--no-browser", "--seed", "3000000") as running:
        address = running.stderr.readline().split()[-1]
        with urllib.request.urlopen(address, timeout=30) as page:
            assert b"<html" in page.read()
        assert running.stdout.readline() == "grasp on HPAC-Grasp-v0: 1 of 1 succeeded\n"
        running.send_signal(signal.SIGINT)
        _, complaints = running.communicate(timeout=60)
    assert (running.returncode, complaints) == (0, "\n")


def test_an_id_is_shown_with_the_policy_that_comes_for_it(capsys):
    words = ["--episodes", "1", "--seed", "3000001", "--no-browser"]
    assert hpac.main(["show", "--env", "HPAC-Posture-v1", *words]) == 0
    assert capsys.readouterr().out.startswith("posture on HPAC-Posture-v1: 1 of 1 succeeded")
    assert {env_id: shipped_for(env_id) for env_id in ("HPAC-GraspAny-v1", "my:Own-v0")} == {
        "HPAC-GraspAny-v1": "grasp-any-wrist",
        "my:Own-v0": "scripted",
    }


def test_the_page_names_policy_grasp_and_id(monkeypatch, capsys):
    titles = []
    monkeypatch.setattr(HandPage, "say", lambda page, about: titles.append(about))
    words = ["--grasp", "rod", "--seed", "3000000", "--episodes", "1", "--no-browser"]
    assert hpac.main(["show", *words]) == 0
    named = "scripted on HPAC-Grasp-v0, grasp rod"
    assert titles == [f"{named}, seed 3000000: the first episode"]
    assert capsys.readouterr().out.startswith(f"{named}: ")


def test_a_film_is_written(tmp_path, capsys, monkeypatch):
    import imageio.v2 as imageio

    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    monkeypatch.setattr(show, "PAUSE", 0.1)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    path = tmp_path / "film.gif"
    words = ["--grasp", "rod", "--set", "max_episode_steps=12", "--episodes", "1", "--json"]
    assert hpac.main(["show", *words, "--record", str(path)]) == 0
    told = capsys.readouterr()
    episode, written = map(json.loads, told.out.splitlines())
    assert (episode["seed"], episode["success"]) == (HELD_OUT_SEED, False)
    assert written == {"written": str(path)}
    assert "frames of seed " in told.err
    assert len(imageio.mimread(path, memtest=False)) >= 12


OTHERS = ("show", "--episodes", "1", "--env", "tests.tiny_task:Filmed-v0", "--record")
"""A film of an environment of another package, which has no engine."""


def test_an_environment_of_another_package_is_filmed(tmp_path, capsys):
    assert hpac.main([*OTHERS, f"{tmp_path}/film.gif"]) == 0
    assert "scripted on tests.tiny_task:Filmed-v0: 0 of 1" in capsys.readouterr().out


def test_a_film_that_does_not_fit_on_the_disk_is_one_line(tmp_path):
    script = """
import hpac, resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
sys.exit(hpac.main(sys.argv[1:]))
"""
    path = f"{tmp_path}/film.gif"
    done = python("-c", script, *OTHERS, path)
    assert (done.returncode, done.stderr) == (2, f"error: cannot write '{path}': File too large\n")
    assert not list(tmp_path.iterdir())


def test_a_film_that_is_ended_leaves_nothing(tmp_path):
    words = [*OTHERS, f"{tmp_path}/film.gif", "--episodes", "100000"]
    with started("-m", "hpac", *words) as running:
        running.stdout.readline()
        assert list(tmp_path.iterdir())
        running.send_signal(signal.SIGTERM)
        _, complaints = running.communicate(timeout=60)
    assert (running.returncode, complaints.splitlines()[-1]) == (130, "interrupted")
    assert not list(tmp_path.iterdir())


def test_a_film_without_its_encoder_names_the_extra(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    said = refused(capsys, lambda: hpac.main(["show", "--record", str(tmp_path / "film.mp4")]))
    assert said.startswith("error: this command needs more: pip install '.[video]'")


def test_a_film_that_ffmpeg_could_not_finish_replaces_none(tmp_path):
    path = tmp_path / "film.mp4"
    path.write_bytes(b"a good film")
    with pytest.raises(OutputError, match="is the disk full"), show._film(path) as film:  # noqa: PT012
        film.append_data(np.zeros((32, 32, 3), np.uint8))
        film.close()
        (temporary,) = set(tmp_path.iterdir()) - {path}
        temporary.write_bytes(b"half a film")
    assert path.read_bytes() == b"a good film"
