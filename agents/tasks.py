"""Environments by id, with a check of the spaces that the agents support; what a policy file says about its origin."""

from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

import hpac_gym  # noqa: F401 - registers the environments, so that an id also works without its module
from agents.command import TaskError
from hpac_gym.policies.made_for import made_for

POLICY = "policy.zip"
"""Name of the policy file in the folder of a run."""
LIBRARIES = ("hpac_gym", "numpy", "gymnasium", "mujoco-core", "pybullet", "torch")


def make_task(env_id: str, **options) -> gymnasium.Env:
    """Create the environment of an id, ``name-v0`` or ``module:name-v0``.

    Raises:
        TaskError: The id is unknown, an option is invalid, or the action is not a flat box of −1…1.
    """
    try:
        env = gymnasium.make(env_id, disable_env_checker=True, **options)
    except (gymnasium.error.Error, ModuleNotFoundError) as error:
        raise TaskError(f"no environment '{env_id}': {error}") from None
    except TypeError as error:
        reason = f"{error}".partition(" was raised from")[0]
        raise TaskError(f"no environment '{env_id}' with {', '.join(options)}: {reason}") from None
    done = env.action_space
    if not (isinstance(done, Box) and len(done.shape) == 1 and np.all(done.low == -1) and np.all(done.high == 1)):
        raise TaskError(f"environment '{env_id}' acts in {done}: the agents need one flat box of -1…1")
    return env


def target_of(env_id: str, **options) -> dict[str, Any]:
    """Fields of a policy file that identify its environment, one of this package: `env_id` and `made_for`.

    Raises:
        TaskError: As in `make_task`.
    """
    full_id = f"hpac_gym:{env_id}"
    with make_task(full_id, **options) as env:
        return {"env_id": full_id, "made_for": made_for(env)}


def versions() -> dict[str, str]:
    """The versions of Python and of the libraries that a result depends on."""
    found = {"python": python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def other_versions(told: Mapping[str, str]) -> str:
    """The entries of `told` that differ from `versions` here, in words; empty if there are none."""
    here = versions()
    return ", ".join(f"{name} {told.get(name)}, not {here[name]} as here" for name in here if told.get(name) != here[name])
