"""The contenders of `agents.race`: algorithms and their arguments."""

from collections.abc import Mapping
from pkgutil import resolve_name
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from agents import RecipeError
from hpac_gym.errors import install

ALGORITHMS: Mapping[str, str] = {
    "ppo": "stable_baselines3:PPO",
    "sac": "stable_baselines3:SAC",
    "tqc": "sb3_contrib:TQC",
    "crossq": "sb3_contrib:CrossQ",
    "sbx-sac": "sbx:SAC",
    "sbx-tqc": "sbx:TQC",
    "sbx-crossq": "sbx:CrossQ",
}
_SHARED = {
    "seed": 0,
    "num_envs": 32,
    "action_repeat": 4,
    "learning_rate": 5e-4,
    "gamma": 0.95,
    "policy_kwargs": {"net_arch": [128, 128]},
}
BOUNDS: Mapping[str, tuple[Any, float, float]] = {
    "seed": (int, 0, 2**31 - 1),
    "num_envs": (int, 1, 65_536),
    "action_repeat": (int, 1, 1_000),
    "learning_rate": (int | float, 0, 1),
    "gamma": (int | float, 0, 1),
}
"""Type, least and largest value of the arguments that the worlds need too."""
_REPLAY = _SHARED | {
    "n_steps": 4,
    "learning_starts": 4_000,
    "gradient_steps": 8,
    "target_entropy": -6.0,
}
_PPO = _SHARED | {
    "num_envs": 128,
    "batch_size": 512,
    "n_steps": 16,
    "gae_lambda": 0.9,
    "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -0.5},
}
CONTENDERS: Mapping[str, Mapping[str, Any]] = {
    name: _PPO
    if name == "ppo"
    else _REPLAY | ({"learning_rate": 1e-3} if "crossq" in name else {"tau": 0.01})
    for name in ALGORITHMS
}
"""Arguments of each algorithm that are not its library's own, and two of its worlds: their number,
and the control steps for which an action is held, which are one decision. The learning rate is the
initial one; it falls linearly to a twentieth, except in sbx-crossq.
"""


def algorithm_of(name: str) -> type[BaseAlgorithm]:
    """Import an algorithm of `ALGORITHMS`.

    Raises:
        RecipeError: Its library is not installed.
    """
    try:
        return resolve_name(ALGORITHMS[name])
    except ModuleNotFoundError as error:
        raise RecipeError(
            f"{name} needs {error.name}, which is not installed: {install('train,sbx')}"
        ) from None
