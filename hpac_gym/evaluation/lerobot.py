"""`hpac record --format lerobot`: recorded episodes as a LeRobot v3 dataset, written by the package
lerobot itself.
"""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from hpac_gym.errors import DatasetError, install
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
        raise DatasetError(
            f"{env.spec.id} observes a {seen}: LeRobot's format needs one flat Box, as with --obs deploy"
        )
    try:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        raise DatasetError(
            f"LeRobot's format needs Python 3.12 or newer and {install('lerobot')}: {error}"
        ) from None
    return LeRobotDataset


def to_lerobot(recorded: MinariDataset, folder: Path) -> None:
    """Write episodes of `hpac record` as a LeRobot dataset into a new folder.

    A frame has `observation.state`, `action`, `next.reward`, `next.done`, `next.success` and the
    episode's `seed`; the task is the environment's id, without its module.

    Raises:
        DatasetError: The package is not installed, or the observations are not one flat box.
        OutputError: The folder cannot be written, or the disk is full.
    """
    env = recorded.recover_environment()
    made = writer(env)
    space = env.observation_space
    moves = env.action_space
    about = made_for(env)
    task = env.spec.id.rpartition(":")[2]  # without its module
    env.close()
    # Of the deploy vector.
    seen_names = [f"{name}.{label}" for name, label, *_ in about["observation"]]
    features = {
        "observation.state": {
            "dtype": "float32",
            "shape": space.shape,
            "names": _named(seen_names, space),
        },
        "action": {
            "dtype": "float32",
            "shape": moves.shape,
            "names": _named(about["action"], moves),
        },
        **{
            name: {"dtype": kind, "shape": (1,), "names": None}
            for name, kind in {
                "next.reward": "float32",
                "next.done": "bool",
                "next.success": "bool",
                "seed": "int64",
            }.items()
        },
    }
    dataset = made.create(
        recorded.id, CONTROL_HZ, features, root=folder, robot_type="hpac", use_videos=False
    )
    seeds = [one["seed"] for one in recorded.storage.get_episode_metadata(recorded.episode_indices)]
    try:
        with ExitStack() as files:
            # Closes its files; a full disk may show itself only then.
            files.callback(dataset.finalize)
            for seed, episode in zip(
                progress(seeds, "episodes"), recorded.iterate_episodes(), strict=True
            ):
                columns = {
                    "observation.state": episode.observations[:-1],
                    "action": episode.actions,
                    "next.reward": episode.rewards,
                    "next.done": episode.terminations | episode.truncations,
                    "next.success": episode.infos["is_success"][1:],
                    "seed": np.full(len(episode.actions), seed),
                }
                for name, values in columns.items():
                    columns[name] = np.asarray(values, features[name]["dtype"]).reshape(
                        -1, *features[name]["shape"]
                    )
                for row in zip(*columns.values(), strict=True):
                    dataset.add_frame({"task": task, **dict(zip(columns, row, strict=True))})
                dataset.save_episode()
    except OSError as error:
        raise OutputError(
            f"cannot write episodes to '{folder}': {error.strerror or error}"
        ) from error


def _named(names: list[str], space: Box) -> list[str]:
    """A name for each entry of a box: those given, and numbers for the rest."""
    return names + [f"entry {index}" for index in range(len(names), space.shape[0])]
