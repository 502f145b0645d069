"""What an id accepts beside what ``gymnasium.make`` itself does: from signatures and docstrings, for the documentation."""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import gymnasium
from gymnasium.envs.registration import load_env_creator

from hpac_gym.envs.hand_env import HandEnv
from hpac_gym.model import HPAC

OWN = ("self", "task")
"""What an id gives by itself."""


@dataclass(frozen=True, slots=True)
class Argument:
    """An argument of an id: what it may be, its default, and what it does."""

    name: str
    values: str
    default: Any
    meaning: str

    @property
    def shown_default(self) -> str:
        """The default as a person would write it."""
        if self.default is HPAC:
            return "`HPAC`"
        return f'`"{self.default}"`' if isinstance(self.default, str) else f"`{self.default!r}`"


def arguments_of(env_id: str) -> list[Argument]:
    """The arguments of a registered id, in order; where its entry point takes options, those of `HandEnv`."""
    entry = load_env_creator(gymnasium.spec(env_id).entry_point)
    found = _own_arguments(entry)
    return found + _own_arguments(HandEnv) if _takes_options(entry) else found


def _own_arguments(entry: Callable) -> list[Argument]:
    called = entry.__init__ if inspect.isclass(entry) else entry
    kinds, meanings = get_type_hints(called), _documented(entry)
    return [
        Argument(name, _values(kinds[name]), parameter.default, meanings.get(name, ""))
        for name, parameter in inspect.signature(called).parameters.items()
        if name not in OWN and parameter.kind is not parameter.VAR_KEYWORD
    ]


def _takes_options(entry: Callable) -> bool:
    return any(parameter.kind is parameter.VAR_KEYWORD for parameter in inspect.signature(entry).parameters.values())


def _documented(entry: Callable) -> dict[str, str]:
    """The entries of the docstring's "Args", by name."""
    listed = (inspect.getdoc(entry) or "").partition("Args:\n")[2].partition("\n\n")[0]
    return {name: " ".join(text.split()) for name, text in re.findall(r"^ {4}(\w+): (.*(?:\n {5,}.*)*)", listed, re.MULTILINE)}


def _values(kind: Any) -> str:
    """An annotation as a list of what may be given."""
    if isinstance(kind, UnionType) or get_origin(kind) is Union:
        return ", ".join(map(_values, get_args(kind)))
    if get_origin(kind) is Literal:
        return ", ".join(f'`"{value}"`' for value in get_args(kind))
    return "None" if kind is type(None) else f"`{kind.__name__}`"
