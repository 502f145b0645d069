"""`hpac show`: a policy in the browser or in a film."""

import signal
import sys
import time
import urllib.request
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec

import hpac
from hpac_gym import progress, show
from hpac_gym.output import OutputError
from hpac_gym.policies.loading import shipped_for
from hpac_gym.view.page import HandPage
from tests.options import refused
from tests.processes import python, started
from tests.tiny_task import Tiny


def test_a_trained_policy_is_shown_on_a_page():
    words = ["show", "--episodes", "1", "--no-browser", "--seed", "3000000"]
    with started("-m", "hpac", *words) as running:
        address = running.stderr.readline().split()[-1]
        with urllib.request.urlopen(address, timeout=30) as page:
            assert b"<html" in page.read()
        said, complaints = running.communicate(timeout=60)
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
    with started("-m", "hpac", "show", "--no-browser") as running:
        running.stderr.readline()
        time.sleep(1.0)
        running.send_signal(signal.SIGINT)
        _, complaints = running.communicate(timeout=60)
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


def test_a_film_that_does_not_fit_on_the_disk_is_one_line(tmp_path):
    script = """
import hpac, resource, sys
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
sys.exit(hpac.main(sys.argv[1:]))
"""
    path = f"{tmp_path}/film.gif"
    words = ["show", "--grasp", "rod", "--episodes", "1", "--record", path]
    done = python("-c", script, *words)
    assert (done.returncode, done.stderr) == (2, f"error: cannot write '{path}': File too large\n")


class Filmed(Tiny):
    """An environment of another package, which has no engine."""

    metadata: ClassVar = {"render_modes": ["rgb_array"]}

    def __init__(self, render_mode):
        self.render_mode = render_mode

    def render(self):
        return np.full((32, 32, 3), 20 * self._count, np.uint8)


def test_an_environment_of_another_package_is_filmed(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(gymnasium.registry, "Filmed-v0", EnvSpec("Filmed-v0", Filmed))
    words = ["--env", "tests.tiny_task:Filmed-v0", "--record", f"{tmp_path}/film.gif"]
    assert hpac.main(["show", "--episodes", "1", *words]) == 0
    assert "scripted on tests.tiny_task:Filmed-v0: 0 of 1" in capsys.readouterr().out


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
