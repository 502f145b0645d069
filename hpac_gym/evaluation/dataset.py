"""`hpac record`: episodes of a policy as a dataset of Minari or LeRobot, for offline learning and
imitation.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from hpac_gym.command import add_json, ended_as_by_ctrl_c, say, whole_number
from hpac_gym.errors import DatasetError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.options import add_policy_and_env, env_of
from hpac_gym.output import OutputError, writable_folder, writing
from hpac_gym.policies.loading import NAMES, load_policy
from hpac_gym.progress import progress
from hpac_gym.registration import GRASP, full_id

if TYPE_CHECKING:
    import gymnasium
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

    from hpac_gym.policies import Policy

CHUNK = 100  # episodes per write
EPISODE_BYTES = 50_000
"""Disk space for an episode beside its observations, generously [byte]."""
_ABOUT = """\
Runs a policy and writes observations, actions and rewards as a Minari dataset, with the seed and success of every episode.
`minari.MinariDataset(DIR / "data")` opens it, `python -m agents.clone DIR` learns from it; with --format lerobot as one of
LeRobot v3. The folder appears when all episodes are written."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac record`."""
    parser.description = _ABOUT
    add_policy_and_env(
        parser,
        f"id, also module:My-v0 (default: a policy file's own, otherwise {GRASP})",
        default="scripted",
        help=f"{NAMES} (default: %(default)s)",
    )
    parser.add_argument(
        "-n",
        "--episodes",
        type=whole_number(1),
        default=100,
        metavar="N",
        help="number of episodes (default: %(default)s)",
    )
    parser.add_argument(
        "--seed-start",
        type=whole_number(0),
        default=0,
        metavar="SEED",
        help="seed of the first episode; held-out seeds start at 1000000 (default: %(default)s)",
    )
    parser.add_argument(
        "--format",
        choices=("minari", "lerobot"),
        default="minari",
        help="of the dataset (default: %(default)s)",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder to create; must not exist"
    )
    add_json(parser)
    parser.set_defaults(run=ended_as_by_ctrl_c()(_record))


def _record(args: argparse.Namespace) -> int:
    env_id, options = env_of(args, args.policy)
    what = {"seed_start": args.seed_start, "options": options, "normalize": args.normalize}
    if args.format == "minari":
        told = _told(record(args.policy, env_id, args.episodes, args.out, **what))
    else:
        from hpac_gym.evaluation.lerobot import to_lerobot, writer

        with _appearing(args.out) as root:
            with make_env(env_id, **options) as env:
                writer(env)  # what it refuses costs no recording
            dataset = record(args.policy, env_id, args.episodes, root / "minari", **what)
            to_lerobot(dataset, root / "written")
            told = _told(dataset)
    counted = ", ".join(f"{number} {name}" for name, number in told.items())
    say(args.json, f"{counted}: {args.out}", **told, written=str(args.out))
    return 0


def _told(dataset: MinariDataset) -> dict[str, int]:
    held = sum(bool(episode.infos["is_success"][-1]) for episode in dataset.iterate_episodes())
    return {
        "episodes": int(dataset.total_episodes),
        "steps": int(dataset.total_steps),
        "successes": held,
    }


@contextmanager
def _appearing(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out`, whose folder `written` becomes `out` at the end.

    Raises:
        DatasetError: `out` exists already.
        OutputError: `out` cannot be written.
    """
    if os.path.exists(out):
        raise DatasetError(f"'{out}' exists already: name a new folder")
    folder = writable_folder(out.absolute().parent)
    with writing(out):
        temporary = TemporaryDirectory(prefix=f".{out.name}-", dir=folder)
    with temporary as root:
        yield Path(root)
        with writing(out):
            Path(root, "written").rename(out)


def record(
    policy: str,
    env_id: str,
    episodes: int,
    out: Path,
    *,
    seed_start: int = 0,
    options: Mapping[str, Any] | None = None,
    normalize: str | None = None,
) -> MinariDataset:
    """Record episodes of a policy as a dataset.

    Args:
        policy: as in `load_policy`, and `normalize` too.
        env_id: id of the environment.
        episodes: number of episodes; their seeds count upwards.
        out: folder, which must not exist; it appears when everything is written.
        seed_start: seed of the first episode.
        options: options of the environment.

    Raises:
        DatasetError: `out` exists already, or the environment's `entry_point` or options are no text.
        OutputError: `out` cannot be written.
        PolicyError: The policy does not exist, or was made for another environment.
    """
    from minari import create_dataset_from_buffers

    with _appearing(out) as root:
        before = os.environ.get("MINARI_DATASETS_PATH")
        env = make_env(full_id(env_id), **(options or {}))
        try:
            if ":" in env_id:  # or nobody finds the module again; wrappers keep what they once read
                env.unwrapped.spec = replace(env.unwrapped.spec, id=env_id)
            actor = load_policy(policy, env, normalize)
            try:
                env.unwrapped.spec.to_json()
            except (TypeError, ValueError) as error:
                raise DatasetError(f"a data set cannot name {env_id}: {error}") from None
            dataset = None
            task = re.sub(r"-v\d+$", "", env_id.rpartition(":")[2].removeprefix("HPAC-")).lower()
            name = re.sub(r"[^-\w/]+", "-", f"hpac/{task}/{Path(policy).stem}") + "-v0"
            os.environ["MINARI_DATASETS_PATH"] = str(root)
            seeds = progress(range(seed_start, seed_start + episodes), "episodes")
            recorded = (_episode(env, actor, seed) for seed in seeds)
            while buffers := list(islice(recorded, CHUNK)):
                _check_room(out.absolute().parent, buffers)
                if dataset is not None:
                    dataset.update_dataset_from_buffer(buffers)
                    continue
                with warnings.catch_warnings(action="ignore"):  # of missing author data
                    dataset = create_dataset_from_buffers(
                        name, buffers, env=env, algorithm_name=policy, jpeg_encoding=False
                    )
            shutil.move(root / name, root / "written")
        finally:
            env.close()
            os.environ.pop("MINARI_DATASETS_PATH", None)
            if before is not None:
                os.environ["MINARI_DATASETS_PATH"] = before
    return read_dataset(out)


def _check_room(folder: Path, buffers: list[EpisodeBuffer]) -> None:
    """Raise `OutputError` unless the disk has room for episodes: HDF5 ends the whole process where
    it has none.
    """
    seen = [each.observations for each in buffers]
    arrays = [part for one in seen for part in (one.values() if isinstance(one, dict) else [one])]
    needed = 2 * sum(array.nbytes for array in arrays) + len(buffers) * EPISODE_BYTES
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise OutputError(
            f"cannot write {len(buffers)} episodes to '{folder}': they need {needed:,} bytes, {free:,} are free"
        )


def _episode(env: gymnasium.Env, policy: Policy, seed: int) -> EpisodeBuffer:
    """Record one episode; `is_success` in the infos, like the observations, has an entry for the
    reset.
    """
    from minari.data_collector import EpisodeBuffer

    steps = list(run_episodes(single(env), [policy], [seed]))
    done = steps[1:]
    return EpisodeBuffer(
        None,
        seed,
        None,
        _stacked([step.observation for step in steps]),
        np.array([step.action for step in done]),
        [step.reward for step in done],
        [step.terminated for step in done],
        [step.truncated for step in done],
        {"is_success": np.array([False, *(step.success for step in done)])},
    )


def _stacked(observations: list[Any]) -> Any:
    first = observations[0]
    if isinstance(first, dict):
        return {name: np.stack([seen[name] for seen in observations]) for name in first}
    return np.stack(observations)


def read_dataset(folder: Path) -> MinariDataset:
    """Open the dataset that `record` wrote into a folder.

    Raises:
        DatasetError: The dataset is missing or damaged.
    """
    from minari import MinariDataset

    try:
        return MinariDataset(folder / "data")
    except (OSError, ValueError, KeyError, AssertionError) as error:
        raise DatasetError(f"'{folder}' is not a dataset of `hpac record`: {error}") from None
