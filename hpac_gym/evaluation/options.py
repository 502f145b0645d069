"""The options of the environment, with the same names and meaning in every command that makes one."""

import argparse
import json
import math
import re
from collections.abc import Mapping
from copy import deepcopy
from pathlib import Path
from typing import Any

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.own_meshes import MESHES
from hpac_gym.body.own_objects import MAX_SIDE, MIN_SIDE
from hpac_gym.errors import ParameterError
from hpac_gym.policies.loading import NORMALIZE, about, needed_options
from hpac_gym.registration import GRASP_TYPE

DEFAULT_ENV = "hpac_gym:HPAC-Grasp-v0"
MASS = 0.1
FRICTION = 0.8
"""Of an object that is given by its shape (chosen) [kg, 1]."""
SHAPES = {
    "cylinder": ("radius", "half height"),
    "sphere": ("radius",),
    "box": ("half x", "half y", "half z"),
}
OPTIONS = {
    "engine": "mujoco or pybullet",
    "body": "twin or light",
    "obs": "deploy, privileged, ...: what is observed",
    "reward": "dense or sparse",
    "randomize": "nominal, hand, link or full",
    "objects": "split of the objects: train, wide, test or real",
    "hands": "split of the hands: nominal, train or test",
    "types": "types of grasps: all, train, test or one's name",
    "grasp": "a named grasp, or a grasp type, for the tasks that have them",
    "object": "cylinder:RADIUS,HALF_HEIGHT, sphere:RADIUS, box:HALF,HALF,HALF [m], or a file (.stl, .obj, .urdf; "
    "a mesh has 0.1 kg unless --set object.mass)",
    "hand": "file of the simulated hand: its tendons, springs and servos",
    "model": "what commands are computed with: a hand file, hand or calibrated",
}
"""Options of an environment by name. All others, such as `wrist`, are given with ``--set``."""

PLACEHOLDERS = {"grasp": "NAME", "object": "SHAPE:M,M", "hand": "FILE", "model": "FILE"}


def add_env_options(parser: argparse.ArgumentParser, env: str, but: tuple[str, ...] = ()) -> None:
    """Add the options of the environment to a command; `env_options` reads them.

    Args:
        parser: the command's.
        env: help of ``--env``.
        but: options that the command gives another meaning.
    """
    group = parser.add_argument_group("environment (defaults: the environment's own)")
    group.add_argument("--env", metavar="ID", help=env)
    for name, meaning in OPTIONS.items():
        if name not in but:
            group.add_argument(f"--{name}", metavar=PLACEHOLDERS.get(name), help=meaning)
    group.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="any other option, such as config.weights.effort=-0.1 or config.mass=0.1,0.4; may be repeated",
    )


def add_policy_and_env(
    parser: argparse.ArgumentParser, env: str, but: tuple[str, ...] = (), **policy: Any
) -> None:
    """The arguments of a command that runs a policy in an environment of its choice, `env_of`.

    Args:
        parser: the command's.
        env: help of ``--env``.
        but: options of the environment that the command gives another meaning.
        policy: what ``--policy`` is, for the parser.
    """
    parser.add_argument("--policy", **policy)
    parser.add_argument("--normalize", metavar="FILE", help=NORMALIZE)
    add_env_options(parser, env, but)


def env_options(args: argparse.Namespace, env_id: str) -> dict[str, Any]:
    """The options that were given, as `make_env` takes them for an id and a results file tells
    them.

    Raises:
        ParameterError: An ``--object`` or ``--set`` has another form, or two options mean the same.
    """
    found: dict[str, Any] = {
        name: value for name in OPTIONS if (value := getattr(args, name, None)) is not None
    }
    if "grasp" in found and env_id.rpartition(":")[2] == GRASP_TYPE:
        if "types" in found:
            raise ParameterError(
                f"--grasp {found['grasp']!r} and --types {found['types']!r} were given: give either"
            )
        found["types"] = found.pop("grasp")
    if "object" in found and isinstance(given := object_of(found["object"]), dict):
        found["object"] = given
    found = with_set(found, args.set)
    if name := next((name for name in OF_PYTHON if name in found), None):
        raise ParameterError(f"--set {name}: only a program in Python can give it")
    return found


def env_id_of(policy: str) -> str:
    """The environment that a policy was made for; `DEFAULT_ENV` for one whose file does not tell.

    Raises:
        PolicyError: The file is damaged.
    """
    return about(policy).get("env_id", DEFAULT_ENV)


def env_of(args: argparse.Namespace, policy: str) -> tuple[str, dict[str, Any]]:
    """The environment that was asked for, or else the policy's own, and its options: those that the
    policy needs, and those that were given.

    Raises:
        ParameterError: As in `env_options`.
        PolicyError: As in `env_id_of`.
    """
    env_id = args.env or env_id_of(policy)
    return env_id, needed_options(policy, env_id) | env_options(args, env_id)


OF_PYTHON = ("transmit", "physics")
"""Arguments of the environments that no text can give."""
_PYTHON = {"True": "true", "False": "false", "None": "null"}


def with_set(options: Mapping[str, Any], texts: list[str]) -> dict[str, Any]:
    """Options with those of ``--set``, whose names may lead into dictionaries.

    Raises:
        ParameterError: A text is not NAME=VALUE, or its name leads into something else.
    """
    chosen = deepcopy(dict(options))
    for text in texts:
        path, equals, value = text.partition("=")
        *parents, name = path.split(".")
        if not equals or not all([*parents, name]):
            raise ParameterError(f"--set '{text}' is not NAME=VALUE, such as config.hold_time=2")
        place: Any = chosen
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise ParameterError(f"--set '{text}': {parent} is {place!r}, and has no {name}")
        value = _PYTHON.get(value, value)
        numbers = re.fullmatch(r"[-+.\deE\s]+(,[-+.\deE\s]+)+", value)
        try:
            place[name] = json.loads(f"[{value}]" if numbers else value)
        except ValueError:
            place[name] = value
    return chosen


def object_of(text: str) -> ObjectSpec | dict[str, Any]:
    """The object of an ``--object``: a shape with its sizes, or the arguments of `own_object` for
    a file.

    Raises:
        ParameterError: It is neither.
    """
    suffix = Path(text).suffix.lower()
    if suffix == ".urdf":
        return {"path": text}
    if suffix in MESHES:
        return {"path": text, "mass": MASS}
    shape, _, sizes = text.partition(":")
    try:
        half = [float(size) for size in sizes.split(",")]
        if len(half) != len(SHAPES[shape]) or not all(map(math.isfinite, half)):
            raise ValueError
    except (KeyError, ValueError):
        forms = ", ".join(f"{name}:{','.join(parts)}" for name, parts in SHAPES.items())
        raise ParameterError(
            f"--object '{text}' is not one of {forms}, in m, nor a file {', '.join(MESHES)}, .urdf"
        ) from None
    if 2 * min(half) < MIN_SIDE or 2 * max(half) > MAX_SIDE:
        raise ParameterError(
            f"--object '{text}': radii and half sides must be {MIN_SIDE / 2} to {MAX_SIDE / 2} m"
        )
    x, y, z = {1: half * 3, 2: [half[0], *half], 3: half}[len(half)]
    return ObjectSpec(shape, (x, y, z), MASS, FRICTION)
