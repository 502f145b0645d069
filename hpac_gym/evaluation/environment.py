"""Environments by their ids, and the versions of the libraries that their results depend on."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv

from hpac_gym.envs.options import check_number
from hpac_gym.errors import EnvError, HpacError
from hpac_gym.evaluation.options import object_of
from hpac_gym.registration import register_all

LIBRARIES = ("hpac_gym", "numpy", "gymnasium", "mujoco-core", "pybullet", "torch")


def make_env(env_id: str, /, **options: Any) -> gymnasium.Env[Any, Any]:
    """Create the environment of an id, ``name-v0`` or ``module:name-v0``; an object may be given as
    in `hpac_gym.evaluation.options.object_of`.

    Raises:
        EnvError: The id is unknown, an option is invalid, or the action is not a flat box of −1…1.
        ParameterError: `max_episode_steps` is no whole number from 1 on.
    """
    if (steps := options.get("max_episode_steps")) is not None:
        check_number("max_episode_steps", steps)
    register_all()  # which a command leaves to those that make environments
    with _refusing(env_id, options):
        env = gymnasium.make(env_id, disable_env_checker=True, **with_object(options))
    space = env.action_space
    if not (
        isinstance(space, Box)
        and len(space.shape) == 1
        and np.all(space.low == -1)
        and np.all(space.high == 1)
    ):
        raise EnvError(
            f"environment '{env_id}' acts in {space}: policies need one flat box of -1…1"
        )
    return env


def make_envs(env_id: str, count: int, /, **options: Any) -> VectorEnv[Any, Any, Any]:
    """Create n environments of an id without autoreset.

    Raises:
        EnvError: As in `make_env`.
    """
    register_all()
    with _refusing(env_id, options):
        return gymnasium.make_vec(env_id, count, autoreset_mode="Disabled", **with_object(options))


def with_object(options: Mapping[str, Any]) -> dict[str, Any]:
    """Options with an object, if they name one in text, in the place of its text."""
    given = options.get("object")
    return {**options} | ({"object": object_of(given)} if isinstance(given, str) else {})


@contextmanager
def _refusing(env_id: str, options: Mapping[str, Any]) -> Iterator[None]:
    if env_id.startswith(":") or env_id.count(":") > 1:
        raise EnvError(f"no environment '{env_id}': an id is name-v0 or module:name-v0")
    try:
        yield
    except (gymnasium.error.Error, ModuleNotFoundError, SyntaxError) as error:
        raise EnvError(f"no environment '{env_id}': {error}") from None
    except HpacError:
        raise
    except (TypeError, ValueError) as error:
        reason = f"{error}".partition(" was raised from")[0]
        given = ", ".join(name for name in options if name != "render_mode")
        given = f" with {given}" if given else ""
        raise EnvError(f"no environment '{env_id}'{given}: {reason}") from None


def versions(*more: str) -> dict[str, str]:
    """The versions of Python and of the libraries that a result depends on, and of `more`
    libraries.
    """
    versions_here = {"python": python_version()}
    for name in (*LIBRARIES, *more):
        try:
            versions_here[name] = version(name)
        except PackageNotFoundError:
            versions_here[name] = "not installed"
    return versions_here
