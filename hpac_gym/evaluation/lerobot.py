"""`hpac record --format lerobot`: recorded episodes as a LeRobot v3 dataset, written by the package lerobot itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from hpac_gym.evaluation.dataset import DatasetError
from hpac_gym.output import OutputError
from hpac_gym.policies.made_for import made_for
from hpac_gym.progress import progress
from hpac_gym.tasks.task import CONTROL_HZ

if TYPE_CHECKING:
    from minari import MinariDataset


def writer(env: gymnasium.Env) -> Any:
    """The class that reads and writes LeRobot's datasets, for episodes of an environment.

    Raises:
        DatasetError: The package is not installed, or the observations are not one flat box.
    """
    space = env.observation_space
    if not isinstance(space, Box) or len(space.shape) != 1:
        seen = type(space).__name__
        raise DatasetError(f"{env.spec.id} observes a {seen}: LeRobot's format needs one flat Box, as with --obs deploy")
    try:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        raise DatasetError(f"LeRobot's format needs Python 3.12 or newer and pip install 'hpac_gym[lerobot]': {error}") from None
    return LeRobotDataset


def to_lerobot(recorded: MinariDataset, folder: Path) -> None:
    """Write episodes of `hpac record` as a LeRobot dataset into a new folder.

    A frame has `observation.state`, `action`, `next.reward`, `next.done`, `next.success` and the episode's `seed`; the task is
    the environment's id.

    Raises:
        DatasetError: The package is not installed, or the observations are not one flat box.
        OutputError: The folder cannot be written, or the disk is full.
    """
    env = recorded.recover_environment()
    made, space, moves, about, task = writer(env), env.observation_space, env.action_space, made_for(env), env.spec.id
    env.close()
    seen_names = [f"{name}.{label}" for name, label, *_ in about["observation"]]  # of the deploy vector
    features = {
        "observation.state": {"dtype": "float32", "shape": space.shape, "names": _named(seen_names, space)},
        "action": {"dtype": "float32", "shape": moves.shape, "names": _named(about["action"], moves)},
        **{name: {"dtype": kind, "shape": (1,), "names": None} for name, kind in
           {"next.reward": "float32", "next.done": "bool", "next.success": "bool", "seed": "int64"}.items()},
    }  # fmt: skip
    dataset = made.create(recorded.id, CONTROL_HZ, features, root=folder, robot_type="hpac", use_videos=False)
    seeds = [one["seed"] for one in recorded.storage.get_episode_metadata(recorded.episode_indices)]
    try:
        for seed, episode in zip(progress(seeds, "episodes"), recorded.iterate_episodes(), strict=True):
            over = episode.terminations | episode.truncations
            columns = episode.rewards, over, episode.infos["is_success"][1:]
            for seen, action, *values in zip(episode.observations[:-1], episode.actions, *columns, strict=True):
                values = dict(zip(("next.reward", "next.done", "next.success", "seed"), (*values, seed), strict=True))
                frame = {name: np.array([value], features[name]["dtype"]) for name, value in values.items()}
                dataset.add_frame({"observation.state": seen, "action": action, "task": task, **frame})
            dataset.save_episode()
        dataset.finalize()
    except OSError as error:
        raise OutputError(f"cannot write episodes to '{folder}': {error.strerror or error}") from error
    finally:
        dataset.finalize()  # closes its files


def _named(names: list[str], space: Box) -> list[str]:
    """A name for each entry of a box: those given, and numbers for the rest."""
    return names + [f"entry {index}" for index in range(len(names), space.shape[0])]
