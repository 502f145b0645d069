"""What a policy was made for, in words and numbers, and how that differs from where it is to be used."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import gymnasium

from hpac_gym.model import HPAC, SERVOS, hand_to_toml
from hpac_gym.tasks.task import CONTROL_HZ


def made_for(env: gymnasium.Env) -> dict[str, Any]:
    """What a policy that acts in an environment relies on; empty for one that is not of this package.

    Returns:
        `observation`: name, label, unit and bounds of every entry of the *deploy* vector, in order; `action`: the servos, in
        order; `control_hz`: decisions a second, each of 1 / control_hz [s]; `hand_sha256`: of the hand file of the model that
        the observation is computed with; `task_sha256`: of the task's configuration.
    """
    task = getattr(env.unwrapped, "task", None)
    if task is None or not hasattr(task, "terms"):
        return {}
    entries = [[term.name, label, term.unit, term.low, term.high] for term in task.terms for label in term.labels]
    hand = getattr(env.unwrapped, "hand", HPAC)
    return {
        "observation": entries,
        "action": list(SERVOS),
        "control_hz": CONTROL_HZ,
        "hand_sha256": _digest(hand_to_toml(hand)),
        "task_sha256": _digest(f"{type(task).__name__} {task.config!r}"),
    }


def difference(file: Mapping[str, Any], here: Mapping[str, Any]) -> str | None:
    """How an environment differs from what a policy was made for, in one line; None if it does not.

    What either of them does not tell is not compared; the task's configuration is told, and not compared, since a policy may
    be judged on other ranges than it was trained on.
    """
    for name in ("control_hz", "action", "hand_sha256"):
        if name in file and name in here and file[name] != here[name]:
            return f"{name} was {file[name]}, and is {here[name]}"
    if "observation" not in file or "observation" not in here:
        return None
    old, new = file["observation"], here["observation"]
    for place in range(max(len(old), len(new))):
        first, second = (list(entries[place]) if place < len(entries) else None for entries in (old, new))
        if first != second:
            return f"observation entry {place} was {_told(first)}, and is {_told(second)}"
    return None


def _told(entry: list[Any] | None) -> str:
    if entry is None:
        return "none"
    name, label, unit, low, high = entry
    return f"{name} {label} [{unit}] {low:g}…{high:g}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
