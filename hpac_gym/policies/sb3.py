"""Models that Stable-Baselines3, sb3-contrib or SBX saved, with their `VecNormalize` statistics, as
policies.

The algorithm is not needed: a model's zip names the class of its policy, with its arguments and its
weights. Reading one executes what is pickled in it, as `PPO.load` does: open only files that you
trust."""

import json
import os
import zipfile
from functools import lru_cache
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import iterate
from numpy.typing import NDArray

from hpac_gym.errors import PolicyError, install
from hpac_gym.output import file_hash
from hpac_gym.policies.made_for import id_of

NONE = "none"
"""Instead of a file of statistics: the model was trained without."""
_NEEDED = (
    "policy",
    "policy_class",
    "policy_kwargs",
    "observation_space",
    "action_space",
    "use_sde",
    "_last_obs",
)


class SB3Policy:
    """A saved model without its exploration.

    Args:
        policy: the model's policy.
        normalize: its `VecNormalize` statistics, or None.
    """

    def __init__(self, policy: Any, normalize: Any = None) -> None:
        self._policy = policy
        self._normalize = normalize

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[Any], Any]:
        """As in `hpac_gym.policies.Policy`."""
        if self._normalize is not None:
            observation = self._normalize.normalize_obs(observation)
        action, state = self._policy.predict(observation, state, episode_start, deterministic)
        return np.asarray(action), state


def statistics_of(path: Path, normalize: str | None = None) -> Path | None:
    """The file of a model's `VecNormalize` statistics: the named one, or one beside it, or None.

    Beside it are sought `vecnormalize.pkl`, `MODEL.pkl`, `MODEL_vecnormalize.pkl`, what
    `CheckpointCallback` writes with `save_vecnormalize=True`, and RL Zoo's `MODEL/vecnormalize.pkl`.

    Raises:
        PolicyError: There is no such file.
    """
    if normalize == NONE:
        return None
    if normalize is not None:
        if not os.path.isfile(normalize):
            raise PolicyError(f"no VecNormalize statistics '{normalize}'")
        return Path(normalize)
    prefix, _, steps = path.stem.removesuffix("_steps").rpartition("_")
    names = (
        f"{path.stem}.pkl",
        f"{path.stem}_vecnormalize.pkl",
        f"{prefix}_vecnormalize_{steps}_steps.pkl",
        f"{path.stem}/vecnormalize.pkl",
        "vecnormalize.pkl",
    )
    return next((file for name in names if os.path.isfile(file := path.parent / name)), None)


def about_model(path: Path, normalize: str | None = None) -> dict[str, Any]:
    """What identifies a saved model, without executing it: class of the policy, steps of its
    training, SHA-256 of its file and of its statistics.

    Raises:
        PolicyError: It is none, or a file cannot be read.
    """
    data = _data(path)
    kind = data.get("policy_class")
    told: dict[str, Any] = {"sha256": file_hash(path, PolicyError)}
    if isinstance(kind, dict) and "__module__" in kind:
        told["algorithm"] = str(kind["__module__"])
    if isinstance(data.get("num_timesteps"), int):
        told["env_steps"] = data["num_timesteps"]
    if (statistics := statistics_of(path, normalize)) is not None:
        told["normalize"] = str(statistics)
        told["normalize_sha256"] = file_hash(statistics, PolicyError)
    return told


def _data(path: Path) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
            if not isinstance(data, dict):
                raise TypeError("its data are no object")
            return data
    except KeyError:
        raise PolicyError(
            f"'{path}' is neither a model of Stable-Baselines3 nor a policy file (.hpac)"
        ) from None
    except Exception as error:  # a damaged file can make its reader raise anything
        raise PolicyError(f"model '{path}' is damaged: {error}") from None


def read_model(path: Path, env: gymnasium.Env[Any, Any], normalize: str | None = None) -> SB3Policy:
    """Load a saved model for an environment.

    Args:
        path: what `model.save` wrote.
        env: the environment in which the policy acts.
        normalize: file of its statistics; "none": it was trained without; None: as
            `statistics_of` finds them.

    Raises:
        PolicyError: A library is missing, a file is missing or damaged, the spaces are not those
            of the environment, or the model was trained on normalised observations and there are
            no statistics.
    """
    statistics = statistics_of(path, normalize)
    policy, normalised = _policy(path, path.stat().st_mtime_ns)
    for name in ("observation_space", "action_space"):
        ours = getattr(env, name)
        if (theirs := getattr(policy, name)) not in (ours, _channels_first(ours)):
            its, our = _briefly(theirs, ours)
            raise PolicyError(
                f"model '{path}' has the {name} {its}, {id_of(env)} has {our}: name the model's environment with --env, "
                "its observation with --obs"
            )
    if statistics is None:
        if normalised and normalize != NONE:
            raise PolicyError(
                f"model '{path}' was trained on normalised observations: name the file of its VecNormalize "
                f"statistics with --normalize, or --normalize {NONE} if it has none"
            )
        return SB3Policy(policy)
    return SB3Policy(policy, _statistics(statistics, statistics.stat().st_mtime_ns, policy))


def _channels_first(space: gymnasium.Space[Any]) -> gymnasium.Space[Any]:
    """The space as a model has it, whose training puts the channels of a picture first."""
    from stable_baselines3.common.preprocessing import is_image_space, is_image_space_channels_first
    from stable_baselines3.common.vec_env import VecTransposeImage

    if isinstance(space, gymnasium.spaces.Dict):
        return gymnasium.spaces.Dict({key: _channels_first(part) for key, part in space.items()})
    if not (isinstance(space, gymnasium.spaces.Box) and is_image_space(space)):
        return space
    first = is_image_space_channels_first(space)
    return space if first else VecTransposeImage.transpose_space(space)


def _briefly(theirs: gymnasium.Space[Any], ours: gymnasium.Space[Any]) -> tuple[str, ...]:
    """Two spaces that differ: their shapes, or if these agree the bounds of the first entry that
    differs.
    """
    told = _shape(theirs), _shape(ours)
    if told[0] != told[1]:
        return told
    flat: list[Any] = [gymnasium.spaces.flatten_space(space) for space in (theirs, ours)]
    bounds = [np.stack([space.low, space.high], axis=1) for space in flat]
    at = int((bounds[0] != bounds[1]).any(axis=1).argmax())
    return tuple("{} with entry {} in {:g}…{:g}".format(told[0], at, *ends[at]) for ends in bounds)


def _shape(space: gymnasium.Space[Any]) -> str:
    if isinstance(space, gymnasium.spaces.Dict):
        return ", ".join(f"{name} {_shape(part)}" for name, part in space.items())
    return f"{space.shape} {space.dtype}" if isinstance(space, gymnasium.spaces.Box) else str(space)


@lru_cache(maxsize=8)
def _policy(path: Path, _changed: int) -> tuple[Any, bool]:
    """The policy of a model, and whether its last observation lies outside its observation space,
    as only a normalised one does.
    """
    data = _data(path)
    try:
        from stable_baselines3.common.save_util import load_from_zip_file

        unneeded = dict.fromkeys(set(data) - set(_NEEDED))
        found, parameters, _ = load_from_zip_file(path, custom_objects=unneeded, device="cpu")
        data = found or {}
        policy = data.get("policy")  # SBX saves it whole
        if policy is None:
            make = data["policy_class"]
            kwargs = {**data["policy_kwargs"]} | ({"use_sde": True} if data.get("use_sde") else {})
            if "lr_schedule" in signature(make).parameters:
                kwargs["lr_schedule"] = lambda _: 0.0
            policy = make(data["observation_space"], data["action_space"], **kwargs)
            policy.load_state_dict(parameters["policy"])
            policy.set_training_mode(False)
    except ModuleNotFoundError as error:
        raise PolicyError(
            f"model '{path}' needs {error.name}, which is not installed: {install('train')}"
        ) from None
    except Exception as error:  # a damaged file can make its reader raise anything
        raise PolicyError(f"model '{path}' is damaged: {error!r}".splitlines()[0]) from None
    last = data.get("_last_obs")
    rows = [] if last is None else iterate(data["observation_space"], last)
    return policy, any(row not in data["observation_space"] for row in rows)


@lru_cache(maxsize=8)
def _statistics(path: Path, _changed: int, policy: Any) -> Any:
    from stable_baselines3.common.save_util import load_from_pkl

    try:
        statistics = load_from_pkl(path)
        wanted = policy.observation_space
        if wanted not in ((scaled := statistics.observation_space), _channels_first(scaled)):
            its, model = _briefly(scaled, wanted)
            raise PolicyError(
                f"'{path}' holds VecNormalize statistics of {its}, the model observes {model}: name its own with "
                f"--normalize, or --normalize {NONE} if it has none"
            )
        statistics.normalize_obs(scaled.sample())
    except PolicyError:
        raise
    except Exception as error:  # a damaged file can make its reader raise anything
        raise PolicyError(
            f"'{path}' holds no VecNormalize statistics of the model: {error!r}".splitlines()[0]
        ) from None
    return statistics
