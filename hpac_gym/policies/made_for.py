"""The environment interface that a policy was made for, and its differences from another
environment.
"""

import hashlib
import warnings
from collections.abc import Mapping
from itertools import zip_longest
from typing import Any

import gymnasium
from gymnasium.spaces import Box, Dict, Space

from hpac_gym.errors import PolicyError
from hpac_gym.model import HPAC, SERVOS, Hand, hand_to_toml
from hpac_gym.tasks.task import CONTROL_HZ


def made_for(env: gymnasium.Env[Any, Any]) -> dict[str, Any]:
    """The properties of an environment that its policies rely on; empty for environments of other
    packages.

    Returns:
        `observation`: name, label, unit and bounds of every entry of the *deploy* vector, in order,
        after those of the achieved and the desired goal; `action`: the servos, in order;
        `control_hz`: control rate [Hz]; `hand_sha256`: hash of the hand file of the model with
        which the observation is computed; `task_sha256`: hash of the task's configuration.
    """
    task = getattr(env.unwrapped, "task", None)
    if task is None or not hasattr(task, "terms"):
        return {}
    named = [
        (goal, term)
        for goal in ("achieved_goal", "desired_goal")
        for term in getattr(task, "goal_terms", ())
    ]
    named += [(term.name, term) for term in task.terms]
    entries = [
        [name, label, term.unit, term.low, term.high]
        for name, term in named
        for label in term.labels
    ]
    return {
        "observation": entries,
        "action": list(SERVOS),
        "control_hz": CONTROL_HZ,
        "hand_sha256": _digest(hand_to_toml(_model(env))),
        "task_sha256": _digest(f"{type(task).__name__} {task.config!r}"),
    }


def difference(file: Mapping[str, Any], here: Mapping[str, Any]) -> str | None:
    """First difference between an environment and the one a policy was made for, in one line; None
    if there is none.

    Missing entries are not compared. The task's configuration is recorded but not compared, since a
    policy may be evaluated on other ranges than it was trained on; nor is the hand, since a policy
    acts in synergies, which mean the same on every hand."""
    for name in ("control_hz", "action"):
        if name in file and name in here and file[name] != here[name]:
            return f"{name} was {file[name]}, and is {here[name]}"
    if "observation" in file and "observation" in here:
        pairs = zip_longest(file["observation"], here["observation"])
        for place, (old, new) in enumerate(pairs):
            if old != new:
                return f"observation entry {place} was {_told(old)}, and is {_told(new)}"
    return None


def id_of(env: gymnasium.Env[Any, Any]) -> str:
    """The id of an environment; the name of its class if it was made without one."""
    return env.spec.id if env.spec else type(env.unwrapped).__name__


def same_id(one: str, other: str) -> bool:
    """Whether two ids name one environment, with or without the module that registers it."""
    return one.rpartition(":")[2] == other.rpartition(":")[2]


def options_of(told: Mapping[str, Any]) -> dict[str, Any]:
    """Options of the environment without which a policy cannot act in it, of its description or its
    card: a free wrist for one that moves or shifts it, and the observation of one that sees more
    than *deploy*.
    """
    closure = told.get("decision", told).get("closure") or {}  # a card's is under its decision
    shifts = {"wrist": "free"} if closure.get("shift") else {}
    return shifts | {name: told[name] for name in ("wrist", "obs") if told.get(name)}


def require_fit(
    what: str, told: Mapping[str, Any], sizes: tuple[int, int], env: gymnasium.Env[Any, Any]
) -> None:
    """Refuse a policy that was made for another interface; warn of one made with the model of
    another hand, unless it is the nominal one, whose policies are for calibrated hands too.

    Args:
        what: the policy in the message, such as "policy file 'policy.hpac'".
        told: its description: `env_id`, with or without the module that registers it; its
            `made_for`; and what `options_of` reads, without which the sizes are others.
        sizes: numbers of values that it observes, and of its actions.
        env: the environment in which it is to act.

    Raises:
        PolicyError: It was made for another environment, rate, action or observation.
    """
    here = id_of(env)
    made = told.get("made_for", {})
    if not same_id(told["env_id"], here):
        raise PolicyError(f"{what} was trained on {told['env_id']}, not on {here}")
    try:
        hand_sha256 = made.get("hand_sha256")
        differs = difference(made, made_for(env))
    except (AttributeError, TypeError, ValueError) as error:
        raise PolicyError(f"{what} is damaged: made_for is not readable: {error}") from None
    if differs:
        raise PolicyError(f"{what} does not fit {here}: {differs}")
    space = env.observation_space
    if (observed := vector_size(space)) is None:
        parts = space.items() if isinstance(space, Dict) else [("observation", space)]
        shapes = ", ".join(f"{name} {part.shape}" for name, part in parts)
        raise PolicyError(f"{what} takes a vector, {here} observes {shapes}")
    if sizes != (wanted := (observed, vector_size(env.action_space))):
        needs = "".join(f"; it needs {name}={value!r}" for name, value in options_of(told).items())
        raise PolicyError(f"{what} maps {sizes} values, {here} needs {wanted}{needs}")
    hand = _model(env)
    fitting = (None, *(_digest(hand_to_toml(one)) for one in (HPAC, hand)))
    if hand_sha256 not in fitting:
        remark = f"was made with another hand, and acts here with the model of '{hand.name}'"
        warnings.warn(f"{what} {remark}", stacklevel=3)


def vector_size(space: Space[Any]) -> int | None:
    """Size of a `hpac_gym.policies.policy.vector` of observations; None if they contain something
    else, such as pictures.
    """
    parts = list(space.values()) if isinstance(space, Dict) else [space]
    shapes = [part.shape for part in parts if isinstance(part, Box)]
    if len(shapes) == len(parts) and all(len(shape) == 1 for shape in shapes):
        return sum(size for (size,) in shapes)
    return None


def _model(env: gymnasium.Env[Any, Any]) -> Hand:
    """The model of an environment; the nominal one where every episode has its own."""
    model = getattr(env.unwrapped, "model", HPAC)
    return model if isinstance(model, Hand) else HPAC


def _told(entry: list[Any] | None) -> str:
    if entry is None:
        return "none"
    name, label, unit, low, high = entry
    return f"{name} {label} [{unit}] {low:g}…{high:g}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
