"""`hpac show`: a policy in the browser or in a film."""

import signal
import subprocess
import sys
import time
import urllib.request

import pytest

import hpac
from hpac_gym import progress
from hpac_gym.policies.loading import shipped_for
from hpac_gym.view.page import HandPage
from tests.options import refused


def test_a_trained_policy_is_shown_on_a_page():
    words = ["show", "--episodes", "1", "--no-browser", "--seed", "3000000"]
    running = subprocess.Popen(
        [sys.executable, "-m", "hpac", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        address = running.stderr.readline().split()[-1]
        with urllib.request.urlopen(address, timeout=30) as page:
            assert b"<html" in page.read()
        said, complaints = running.communicate(timeout=60)
    finally:
        running.kill()
    assert (running.returncode, complaints) == (0, "")
    assert said == "grasp on HPAC-Grasp-v0: 1 of 1 succeeded\n"


def test_an_id_is_shown_with_the_policy_that_comes_for_it(capsys, tmp_path):
    words = ["--episodes", "1", "--seed", "3000001", "--record", str(tmp_path / "film.gif")]
    assert hpac.main(["show", "--env", "HPAC-Posture-v1", *words]) == 0
    assert capsys.readouterr().out.startswith("posture on HPAC-Posture-v1: 1 of 1 succeeded")
    assert {env_id: shipped_for(env_id) for env_id in ("HPAC-GraspAny-v1", "my:Own-v0")} == {
        "HPAC-GraspAny-v1": "grasp-any-wrist",
        "my:Own-v0": "scripted",
    }


def test_ctrl_c_is_the_end_of_what_has_no_other():
    words = [sys.executable, "-m", "hpac", "show", "--no-browser"]
    running = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    try:
        running.stderr.readline()
        time.sleep(1.0)
        running.send_signal(signal.SIGINT)
        _, complaints = running.communicate(timeout=60)
    finally:
        running.kill()
    assert (running.returncode, complaints) == (0, "\n")


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
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    path = tmp_path / "film.gif"
    assert hpac.main(["show", "--grasp", "rod", "--episodes", "1", "--record", str(path)]) == 0
    told = capsys.readouterr()
    assert f"written: {path}" in told.out
    assert "frames of seed " in told.err
    assert len(imageio.mimread(path, memtest=False)) > 40


def test_a_film_without_its_encoder_names_the_extra(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    said = refused(capsys, lambda: hpac.main(["show", "--record", str(tmp_path / "film.mp4")]))
    assert said.startswith("error: this command needs more: pip install '.[video]'")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--record", "film.doc"], "--record 'film.doc' must end in .gif or .mp4"),
        (["--policy", "none.hpac"], "no policy file 'none.hpac'"),
        (["--grasp", "none"], "no grasp 'none'"),
        (["--env", "CartPole-v1"], "no environment 'CartPole-v1'"),
        (["--record", "/proc/none/film.gif"], "/proc/none"),
    ],
)
def test_wrong_words_are_one_line(words, says, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert says in refused(capsys, lambda: hpac.main(["show", "--episodes", "1", *words]))
