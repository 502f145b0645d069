"""A film of an episode, with the packages of the `video` extra and Gymnasium's own wrapper."""

import gymnasium
import imageio.v3 as iio
from gymnasium.wrappers import RecordVideo

from tests.envs.episodes import Still, run


def test_gymnasiums_wrapper_films_an_episode(tmp_path):
    env = gymnasium.make("HPAC-Grasp-v0", render_mode="rgb_array", max_episode_steps=8)
    with RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True) as filmed:
        run(filmed, Still())
    (film,) = tmp_path.glob("*.mp4")
    frames = iio.imread(film)
    assert frames.shape == (9, 360, 480, 3)
    assert frames.std() > 5


def test_gymnasium_collects_the_pictures_of_an_episode():
    with gymnasium.make("HPAC-Grasp-v0", render_mode="rgb_array_list") as env:
        env.reset(seed=0)
        env.step(env.action_space.sample())
        assert [frame.shape for frame in env.render()] == [(360, 480, 3)] * 2
