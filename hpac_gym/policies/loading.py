"""Loading of policies by name or from a file: wherever a policy goes, all of these go."""

import os
from importlib import import_module
from inspect import signature
from pathlib import Path
from typing import Any
from zipfile import is_zipfile

import gymnasium

from hpac_gym.errors import PolicyError
from hpac_gym.policies.baselines import BASELINES
from hpac_gym.policies.made_for import options_of, require_fit, same_id
from hpac_gym.policies.onnx_model import read_card, read_onnx
from hpac_gym.policies.policy import LearnedPolicy, Policy
from hpac_gym.policies.policy_file import SHIPPED, SUFFIX, policy_path, read_policy
from hpac_gym.policies.sb3 import about_model, read_model

NAMES = (
    f"{', '.join(BASELINES)}, a shipped policy ({', '.join(SHIPPED)}), or FILE.hpac, MODEL.zip, FOLDER or "
    "MODULE:FUNCTION[:TEXT], as docs/train.md tells"
)
"""What `load_policy` loads, for the help of commands."""
NORMALIZE = "VecNormalize statistics of a Stable-Baselines3 model (default: a file beside it); none: it has none"


def load_policy(name: str, env: gymnasium.Env[Any, Any], normalize: str | None = None) -> Policy:
    """Load a policy for this environment.

    Args:
        name: ``random``, ``scripted``, a shipped policy such as ``grasp``, a policy file, a model
            that Stable-Baselines3 saved, the folder of an exported policy, or
            ``module:function``, which takes the environment and returns a policy;
            ``module:function:text`` passes it the text as well.
        env: the environment in which the policy acts.
        normalize: file of the `VecNormalize` statistics of a Stable-Baselines3 model, or "none";
            None: as `hpac_gym.policies.sb3.statistics_of` finds them. Other policies ignore it.

    Raises:
        PolicyError: The name is unknown; the file is missing, damaged, or made for another
            environment.
    """
    if not hasattr(env, "unwrapped"):
        raise PolicyError(
            f"policy '{name}' needs an environment, as gymnasium.make gives, not {env!r}"
        )
    if name in BASELINES:
        baseline: Policy = BASELINES[name](env)
        return baseline
    path = policy_path(name)
    if os.path.isdir(path):
        return read_onnx(path, env)
    if _is_model(path):
        return read_model(path, env, normalize)
    if os.path.exists(path):
        file = read_policy(name)
        require_fit(f"policy file '{name}'", file.about, file.sizes, env)
        return LearnedPolicy.of(file)
    module, *rest = name.split(":", 2)
    if not rest:
        raise PolicyError(
            f"no policy file '{name}', and not one of {', '.join([*BASELINES, *SHIPPED])}"
        )
    try:
        make = getattr(import_module(module), rest[0])
    except (ImportError, AttributeError, TypeError, ValueError) as error:
        raise PolicyError(f"no policy '{name}': {error}") from None
    if not takes(make, 1 + len(rest[1:])):
        raise PolicyError(f"policy '{name}': {rest[0]} does not take the environment and the text")
    policy: Policy = make(env, *rest[1:])
    if not takes(getattr(policy, "predict", None), 3):
        raise PolicyError(f"policy '{name}' has no predict(observation, state, episode_start)")
    return policy


def takes(function: Any, count: int) -> bool:
    """Whether a function can be called with so many arguments."""
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # a builtin that does not tell
        return True
    return True


def _is_model(path: Path) -> bool:
    """Whether a file is a model of Stable-Baselines3, whose pickles are executed; none that calls
    itself a policy file is.
    """
    return path.suffix != SUFFIX and is_zipfile(path)


def about(name: str, normalize: str | None = None) -> dict[str, Any]:
    """Description of a policy file, or the card of an exported policy, both with `env_id`; what
    identifies a model of Stable-Baselines3. Empty for policies without a file.

    Raises:
        PolicyError: The file is damaged.
    """
    path = policy_path(name)
    if name in BASELINES or not os.path.exists(path):
        return {}
    if _is_model(path):
        return about_model(path, normalize)
    return read_card(path) if os.path.isdir(path) else read_policy(name).about


def needed_options(name: str, env_id: str | None = None) -> dict[str, Any]:
    """`options_of` a policy's description; none for another environment, which `load_policy` refuses.

    Raises:
        PolicyError: The file is damaged.
    """
    told = about(name)
    fits = env_id is None or same_id(told.get("env_id", ""), env_id)
    return options_of(told) if fits else {}


def shipped_for(env_id: str) -> str:
    """Name of a shipped policy of an environment; ``scripted`` if there is none."""
    made = {about(name)["env_id"].removeprefix("hpac_gym:"): name for name in reversed(SHIPPED)}
    return made.get(env_id.removeprefix("hpac_gym:"), "scripted")
