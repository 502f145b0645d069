"""Snapshots of what changes in an episode. Every class names its own state.

A class with state has the attribute `changing`: the names of its attributes that change in an episode,
which are arrays, numbers, generators, or further objects with such names."""

import pickle
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import is_dataclass
from typing import Any

import numpy as np

_PLAIN = np.ndarray | np.generic | float | int | str | np.random.Generator


def save(owner: Any) -> dict[str, Any]:
    """Copies of an object's state, by name."""
    parts = {name: getattr(owner, name) for name in owner.changing}
    return {
        name: save(part) if _has_state(part) else deepcopy(part) for name, part in parts.items()
    }


def restore(owner: Any, saved: dict[str, Any]) -> None:
    """Put an object's state back; the snapshot is not modified."""
    for name, value in saved.items():
        if _has_state(part := getattr(owner, name)):
            restore(part, value)
        else:
            setattr(owner, name, deepcopy(value))


def undeclared(owner: Any, act: Callable[[], object]) -> list[str]:
    """Attributes of an object and its parts that `act` changes and that `restore` does not put back,
    since no class names them.

    For tests of a task: a snapshot without them would not continue as the episode did.

    Args:
        owner: the object, such as `HandEnv.episodes`.
        act: changes it, as the steps of an episode do.
    """
    before = dict(_contents(owner, "", []))
    saved = save(owner)
    act()
    changed = save(owner)
    restore(owner, saved)
    after = dict(_contents(owner, "", []))
    restore(owner, changed)
    return [path for path, content in after.items() if before.get(path) != content]


def _has_state(part: Any) -> bool:
    return hasattr(type(part), "changing")


def _contents(owner: Any, path: str, known: list[Any]) -> Iterator[tuple[str, bytes]]:
    """Arrays, numbers and generators of an object and of its parts, as bytes by their paths, except
    the engine and what is known.
    """
    known.append(owner)
    for name, value in vars(owner).items():
        entries = value.values() if isinstance(value, dict) else value
        if isinstance(value, _PLAIN) or (
            isinstance(value, list | dict) and all(isinstance(entry, _PLAIN) for entry in entries)
        ):
            yield path + name, pickle.dumps(value)
        elif (
            hasattr(value, "__dict__")
            and name != "engine"
            and not (callable(value) or is_dataclass(value) or any(value is one for one in known))
        ):
            yield from _contents(value, f"{path}{name}.", known)
