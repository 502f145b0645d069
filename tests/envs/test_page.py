"""`render_mode="human"`: what a browser gets over HTTP, on a machine without a display."""

import io
import re
import time
import urllib.error
import urllib.request

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import HumanRendering
from PIL import Image

from hpac_gym.envs.page import png

BROWSER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


def test_a_png_holds_the_very_pixels():
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(png(picture)))), picture)


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_a_browser_sees_each_step_while_the_hand_moves_in_real_time(engine, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    env = gymnasium.make("HPAC-Grasp-v0", engine=engine, render_mode="human")
    still = gymnasium.make("HPAC-Grasp-v0", engine=engine, render_mode="rgb_array")
    assert not isinstance(env, HumanRendering)
    for made in (env, still):
        made.reset(seed=0)
    (address,) = re.findall(r"http://127\.0\.0\.1:\d+/", capsys.readouterr().err)
    page = BROWSER.open(address).read()
    assert b'<img src="stream"' in page
    with pytest.raises(urllib.error.HTTPError, match="404"):
        BROWSER.open(address + "etc/passwd")
    with BROWSER.open(address + "stream") as stream:
        np.testing.assert_array_equal(_picture(stream), still.render())
        began = time.monotonic()
        for _ in range(3):
            for made in (env, still):
                made.step(np.zeros(6, np.float32))
            _picture(stream)  # the last one again
            np.testing.assert_array_equal(_picture(stream), still.render())
        assert time.monotonic() - began > 2 / 20
        assert env.render() is None
        env.reset()
        env.close()
        assert len(stream.read()) > 0  # it ends
    assert "http" not in capsys.readouterr().err
    with pytest.raises(urllib.error.URLError):
        BROWSER.open(address)
    still.close()


def test_a_browser_that_leaves_ends_nothing_and_a_vector_shows_its_first_environment(capsys):
    envs = gymnasium.make_vec("HPAC-Posture-v1", num_envs=2, engine="mujoco", render_mode="human")
    envs.reset(seed=0)
    (address,) = re.findall(r"http://\S+", capsys.readouterr().err)
    BROWSER.open(address + "stream").close()
    for _ in range(3):
        envs.step(np.zeros((2, 6), np.float32))
    assert envs.render() is None
    with BROWSER.open(address + "stream") as stream:
        assert _picture(stream).shape == (360, 480, 3)
    envs.close()


def _picture(stream) -> np.ndarray:
    """The next part of a stream."""
    lines = [stream.readline() for _ in range(4)]
    assert lines[0] == b"--picture\r\n"
    data = stream.read(int(lines[2].split()[1]))
    stream.readline()
    return np.asarray(Image.open(io.BytesIO(data)))
