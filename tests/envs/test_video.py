"""A film of an episode, with the packages of the `video` extra and Gymnasium's own wrapper."""

import gymnasium
import imageio.v3 as iio
from gymnasium.wrappers import RecordVideo

import hpac_gym  # noqa: F401  registers the environments


def test_gymnasiums_wrapper_films_an_episode(tmp_path):
    env = gymnasium.make("HPAC-Grasp-v0", render_mode="rgb_array", max_episode_steps=8)
    with RecordVideo(env, str(tmp_path), episode_trigger=lambda episode: True) as filmed:
        filmed.reset(seed=0)
        over = False
        while not over:
            _, _, terminated, truncated, _ = filmed.step(env.action_space.sample())
            over = terminated or truncated
    (film,) = tmp_path.glob("*.mp4")
    frames = iio.imread(film)
    assert frames.shape == (9, 360, 480, 3)
    assert frames.std() > 5
