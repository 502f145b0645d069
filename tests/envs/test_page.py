"""`render_mode="human"`: what the page is told, on a machine without a display. tests/view has the
page in a browser.
"""

import re
import time
import urllib.error
import urllib.request
from unittest.mock import patch

import gymnasium
import numpy as np
import pytest
from gymnasium.wrappers import HumanRendering

from hpac_gym.view.page import HandPage

BROWSER = urllib.request.build_opener(urllib.request.ProxyHandler({}))


@pytest.fixture
def show():
    """`HandPage.show`, which notes what it is told to show."""
    with patch.object(HandPage, "show", autospec=True, side_effect=HandPage.show) as noting:
        yield noting


def test_the_page_shows_each_step_while_the_hand_moves_in_real_time(show, monkeypatch, capsys):
    monkeypatch.delenv("DISPLAY", raising=False)
    env = gymnasium.make("HPAC-Grasp-v0", render_mode="human")
    assert not isinstance(env, HumanRendering)
    env.reset(seed=0)
    (address,) = re.findall(r"http://127\.0\.0\.1:\d+/", capsys.readouterr().err)
    assert b"<html" in BROWSER.open(address).read()
    began = time.monotonic()
    for steps in range(1, 5):
        env.step(np.full(6, -0.5, np.float32))
        assert show.call_count == steps + 1
        shown = show.call_args.args[1]
        state = env.unwrapped.state
        np.testing.assert_array_equal(shown.joint_pos, state.joint_pos[0])
        np.testing.assert_array_equal(shown.object_pos, state.object_pos[0])
        np.testing.assert_array_equal(shown.servo, env.unwrapped.command.servo)
    assert time.monotonic() - began > 3 / 20
    assert shown.text == "0.20 s, close; running"
    assert env.render() is None
    env.close()
    with pytest.raises(urllib.error.URLError):
        BROWSER.open(address)
    assert "http" not in capsys.readouterr().err


def nodes(env) -> set[str]:
    """What is in the scene of a page."""
    return set(env.unwrapped.episodes.pictures.page._server.scene._handle_from_node_name)


def test_every_episode_has_its_own_object_on_the_page(opened):
    env = opened(
        gymnasium.make("HPAC-GraspAny-v1", engine="mujoco", objects="real", render_mode="human")
    )
    seen = []
    for seed in (0, 2, 0):
        env.reset(seed=seed)
        seen.append(nodes(env))
        solids = [name for name in seen[-1] if re.fullmatch(r"/scene/object/\d+", name)]
        assert len(solids) == len(env.unwrapped.episodes.setups[0].object.model.solids)
    assert seen[0] == seen[2]
    assert len({len(names) for names in seen}) > 1


def test_a_vector_shows_its_first_environment_and_a_posture_its_goal(show, opened):
    envs = opened(
        gymnasium.make_vec("HPAC-Posture-v1", num_envs=2, engine="mujoco", render_mode="human")
    )
    envs.reset(seed=0)
    envs.step(np.full((2, 6), 0.3, np.float32))
    assert envs.render() is None
    shown = show.call_args.args[1]
    state = envs.unwrapped.episodes.now.state
    np.testing.assert_array_equal(shown.joint_pos, state.joint_pos[0])
    np.testing.assert_array_equal(shown.goal, envs.unwrapped.episodes.setups[0].goal)
    assert shown.object_rotation is None
    assert not [name for name in nodes(envs) if name.startswith("/scene/object/")]
    page = envs.unwrapped.episodes.pictures.page
    assert page._ghosts["goal"].palm.visible
    assert not page._ghosts["elastic"].palm.visible
