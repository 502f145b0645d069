"""How a policy is trained: one frozen set of settings per recipe, by name."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from math import inf
from typing import Any, get_type_hints

from agents.errors import RecipeError


@dataclass(frozen=True, slots=True)
class Recipe:
    """Settings of one soft actor-critic training.

    A step here is a decision: an action that is held for ``action_repeat`` control steps. The first ``closure_steps`` are
    random closures, which begin and let go within the ranges of control steps that ``closure_begin`` and ``closure_release``
    give, or never let go (see `agents.exploration`); then exploration is state-dependent and keeps its direction for
    ``sde_sample_freq`` decisions, because a hand that trembles at 20 Hz never closes. ``gamma`` looks about 1 / (1 − gamma)
    decisions ahead. The learner makes one update in ``steps_per_update`` decisions while the worker processes step, which
    keeps two cores busy.
    """

    env_id: str
    steps: int
    seed: int = 0
    n_envs: int = 4
    gamma: float = 0.95
    learning_rate: float = 5e-4
    tau: float = 0.01
    batch_size: int = 256
    hidden: tuple[int, ...] = (128, 128)
    action_repeat: int = 4
    learning_starts: int = 500
    closure_steps: int = 4_000
    closure_begin: tuple[int, ...] = (0, 0)
    closure_release: tuple[int, ...] = ()
    steps_per_update: int = 1
    n_steps: int = 4
    sde_sample_freq: int = 4
    buffer_size: int = 400_000
    checkpoint_every: int = 5_000
    threads: int = 1

    def __post_init__(self) -> None:
        for name, (low, high) in BOUNDS.items():
            values = getattr(self, name)
            for value in values if isinstance(values, tuple) else (values,):
                if not low <= value <= high:
                    raise RecipeError(f"{name} is {value}: it must lie in {low:g}…{high:g}")
        if not self.hidden:
            raise RecipeError("hidden is empty: it needs at least one layer")
        for name, lengths in (("closure_begin", (2,)), ("closure_release", (0, 2))):
            if len(bounds := getattr(self, name)) not in lengths or tuple(sorted(bounds)) != tuple(bounds):
                raise RecipeError(f"{name} is {bounds}: it must be a lower and an upper bound")
        if self.buffer_size < self.learning_starts:
            raise RecipeError(f"buffer_size is {self.buffer_size}: it must hold learning_starts, {self.learning_starts} steps")


BOUNDS = {
    "steps": (1, inf),
    "seed": (0, 2**31 - 1),
    "n_envs": (1, 64),
    "gamma": (0.0, 1.0),
    "learning_rate": (1e-8, 1.0),
    "tau": (1e-6, 1.0),
    "batch_size": (1, 65_536),
    "hidden": (1, 4_096),
    "learning_starts": (1, inf),
    "closure_steps": (0, inf),
    "closure_begin": (0, 10_000),
    "closure_release": (0, 10_000),
    "action_repeat": (1, 1_000),
    "steps_per_update": (1, 1_000),
    "n_steps": (1, 100),
    "sde_sample_freq": (1, 10_000),
    "buffer_size": (1, 10**8),
    "checkpoint_every": (1, inf),
    "threads": (1, 256),
}

RECIPES = {
    "grasp-sac": Recipe(env_id="hpac_gym:HPAC-Grasp-v0", steps=300_000),
    "pick-place-sac": Recipe(
        env_id="hpac_gym:HPAC-PickPlace-v0",
        steps=300_000,
        closure_steps=8_000,
        closure_begin=(6, 18),
        closure_release=(70, 95),
    ),
}

_PARSERS: dict[Any, Callable[[str], Any]] = {
    int: lambda text: int(text.replace("_", "")),
    float: float,
    str: str,
    tuple[int, ...]: lambda text: tuple(int(word) for word in text.split(",")),
}


def recipe_named(name: str) -> Recipe:
    """The recipe of that name.

    Raises:
        RecipeError: There is none.
    """
    if name not in RECIPES:
        raise RecipeError(f"unknown recipe '{name}': known are {', '.join(sorted(RECIPES))}")
    return RECIPES[name]


def with_settings(recipe: Recipe, settings: Iterable[str]) -> Recipe:
    """The recipe with ``name=value`` texts put over it, checked again.

    Raises:
        RecipeError: A text is not ``name=value``, names no setting, or its value is none.
    """
    types = get_type_hints(Recipe)
    changes = {}
    for text in settings:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise RecipeError(f"setting '{text}' is not of the form name=value")
        if name not in types:
            raise RecipeError(f"unknown setting '{name}': known are {', '.join(field.name for field in fields(Recipe))}")
        try:
            changes[name] = _PARSERS[types[name]](value)
        except ValueError:
            kind = getattr(types[name], "__name__", "list")
            kind = {"int": "a whole number", "float": "a number", "tuple": "whole numbers with commas between"}[kind]
            raise RecipeError(f"{name} is '{value}': it must be {kind}") from None
    return replace(recipe, **changes)
