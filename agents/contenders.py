"""The contenders of ``agents.race``: algorithms of Stable-Baselines3, sb3-contrib and SBX with their
arguments, and the actors that they have trained."""

from collections.abc import Mapping
from itertools import zip_longest
from pkgutil import resolve_name
from typing import Any

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm

from agents import RecipeError
from hpac_gym.errors import install
from hpac_gym.policies import Actor

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
BOUND = 3.0
"""Bound of PPO's actions, since its normal distribution is unbounded; the environment gets their
tanh.
"""
RENORM_EPSILON = 1e-3
"""Added to the variance by CrossQ's batch normalisation, in sb3-contrib and in SBX."""
SATURATED = 20.0
"""Value beyond which tanh is 1 in single precision."""


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


def trained_actor(model: BaseAlgorithm) -> Actor:
    """The deterministic actor; CrossQ's batch normalisation before a layer becomes part of that
    layer.
    """
    policy = model.policy
    scaling = model.get_vec_normalize_env()
    if hasattr(policy, "actor_state"):  # of SBX
        state = policy.actor_state
        numbers = range(len(policy.net_arch_pi) + 1)
        params = state.params.get("params", state.params)
        seen = getattr(state, "batch_stats", {})
        dense = [
            (params[f"Dense_{number}"]["kernel"].T, params[f"Dense_{number}"]["bias"])
            for number in numbers
        ]
        norms = [
            params[name] | seen[name]
            for name in (f"BatchRenorm_{number}" for number in numbers)
            if name in seen
        ]
    else:
        actor = policy.actor if policy.squash_output else None
        parts = (
            [*actor.latent_pi, actor.mu]
            if actor
            else [*policy.mlp_extractor.policy_net, policy.action_net]
        )
        arrays = [part.state_dict() for part in parts]
        dense = [(array["weight"], array["bias"]) for array in arrays if "weight" in array]
        norms = [
            {name.removeprefix("ra_"): array[name] for name in array}
            for array in arrays
            if "scale" in array
        ]
    layers = []
    for (weight, bias), norm in zip_longest(dense, norms, fillvalue={}):
        weight = np.asarray(weight, dtype=float)
        bias = np.asarray(bias, dtype=float)
        if norm:
            gain, offset, mean, variance = (
                np.asarray(norm[name], dtype=float) for name in ("scale", "bias", "mean", "var")
            )
            gain /= np.sqrt(variance + RENORM_EPSILON)
            weight, bias = weight * gain, bias + weight @ (offset - gain * mean)
        layers.append((weight.astype(np.float32), bias.astype(np.float32)))
    mean = scaling.obs_rms.mean.copy()
    scale = np.sqrt(scaling.obs_rms.var + scaling.epsilon)
    return Actor(
        mean, scale, scaling.clip_obs, tuple(layers), SATURATED if policy.squash_output else BOUND
    )
