"""Training, evaluation and replay of policies for the H-PAC hand; run from a checkout, not part of
the wheel.

The commands share this module: their errors, which end in one line and exit status 2, their parser,
environments by id, and what a policy file says about its origin."""

import argparse
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box

from hpac import Parser
from hpac_gym.errors import HpacError
from hpac_gym.policies.made_for import made_for

POLICY = "policy.zip"  # name of the policy file in the folder of a run
LIBRARIES = ("hpac_gym", "numpy", "gymnasium", "mujoco-core", "pybullet", "torch")


class RecipeError(HpacError, ValueError):
    """A recipe is unknown, or one of its settings is invalid."""


class TaskError(HpacError, ValueError):
    """An environment id is unknown, or its spaces are not supported by the agents."""


class RunError(HpacError, OSError):
    """A results folder cannot be read or written."""


class _Formatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help with every default that there is and that the text does not name itself."""

    def _get_help_string(self, action: argparse.Action) -> str:
        told = action.help or ""
        default = action.default
        named = (
            default is None
            or default is False
            or default in ([], float("inf"))
            or "default:" in told
        )
        return told if named else super()._get_help_string(action)


def command_parser(module: str, description: str) -> Parser:
    """Parser of ``python -m module``; its help shows the description and every default."""
    return Parser(
        prog=f"python -m {module}",
        description=description.replace("``", "'"),
        formatter_class=_Formatter,
    )


def minutes(text: str) -> float:
    """Argument type: a positive number of minutes."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number of minutes")
    return value


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
    if not (
        isinstance(done, Box)
        and len(done.shape) == 1
        and np.all(done.low == -1)
        and np.all(done.high == 1)
    ):
        raise TaskError(
            f"environment '{env_id}' acts in {done}: the agents need one flat box of -1…1"
        )
    return env


def target_of(env_id: str, **options) -> dict[str, Any]:
    """Fields of a policy file that identify its environment, one of this package: `env_id` and
    `made_for`.

    Raises:
        TaskError: As in `make_task`.
    """
    full_id = f"hpac_gym:{env_id}"
    with make_task(full_id, **options) as env:
        return {"env_id": full_id, "made_for": made_for(env)}


def versions(*more: str) -> dict[str, str]:
    """The versions of Python and of the libraries that a result depends on, and of `more`
    libraries.
    """
    found = {"python": python_version()}
    for name in (*LIBRARIES, *more):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def other_versions(told: Mapping[str, str]) -> str:
    """The entries of `told` that differ from `versions` here, in words; empty if there are none."""
    here = versions()
    return ", ".join(
        f"{name} {told.get(name)}, not {here[name]} as here"
        for name in here
        if told.get(name) != here[name]
    )
