"""Tables of the pages of the environments and grasps, from the code."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields
from typing import Any

import gymnasium
import numpy as np

from hpac_gym.envs.options import COMMON
from hpac_gym.envs.randomization import PRESETS, Randomization
from hpac_gym.envs.registered import make_task, options_of_id
from hpac_gym.model import HPAC, JOINTS, SERVOS
from hpac_gym.output import markdown
from hpac_gym.registration import IDS
from hpac_gym.tasks.grasp_data import GRASPS
from hpac_gym.tasks.task import CONTROL_HZ, Option, Task
from hpac_gym.tasks.terms import Term

Makers = dict[str, Callable[[], str]]
TASKS: dict[str, Task] = {env_id: make_task(env_id) for env_id in IDS}
ENTRIES = {tuple(JOINTS): "15 joints", tuple(SERVOS): "6 servos"}
"""Entries of a term that the page of all environments names."""
TERM_HEAD = ("field", "entries", "unit", "bounds", "meaning")


def span(values: Any) -> str:
    """Text of a range or of a single number."""
    numbers = values if isinstance(values, tuple) else (values,)
    return " … ".join(f"{value:g}" for value in numbers)


def summary_table(env_id: str, task: Task) -> str:
    """Table of id, spaces and episode length."""
    spaces = []
    for obs in task.observations:
        with gymnasium.make(env_id, obs=obs) as env:
            action = env.action_space
            words = space_in_words(env.observation_space)
        spaces.append((f'observation space, `obs="{obs}"`', f"`{words}`"))
    rows = (
        ("make", f'`gymnasium.make("hpac_gym:{env_id}")`'),
        ("action space", f"`{action}`"),
        *spaces,
        ("length", f"{task.control_steps} steps, {task.duration:g} s"),
    )
    return markdown(("", ""), rows)


def space_in_words(space: gymnasium.Space) -> str:
    """Text of a space without the bounds of its entries."""
    if isinstance(space, gymnasium.spaces.Dict):
        parts = (f"{name}: {space_in_words(part)}" for name, part in space.items())
        return f"Dict({', '.join(parts)})"
    return f"Box({space.shape}, {space.dtype})"


def option_table(options: Sequence[Option]) -> str:
    """Table of arguments; the sixteen grasps are listed on a page of their own."""
    rows = []
    for option in options:
        values = map(shown, option.values)
        if option.name == "grasp":
            values = ("None", "[a name](../grasps.md)")
        listed = ", ".join(filter(None, (*values, option.others)))
        rows.append((f"`{option.name}`", listed, shown(option.default), option.meaning))
    return markdown(("argument", "values", "default", "meaning"), rows)


def shown(value: Any) -> str:
    """Text of a value in Markdown."""
    if value is None or value is HPAC:
        return "None" if value is None else "`HPAC`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value!r}`"


def action_table() -> str:
    """Table of the six numbers of an action."""
    bounds = zip(HPAC.synergy_min, HPAC.synergy_max, strict=True)
    rows = [
        (index, f"`{name}`", *(f"{bound:.4g}" for bound in pair))
        for index, (name, pair) in enumerate(zip(SERVOS, bounds, strict=True))
    ]
    return markdown(("index", "joint that the servo drives", "at −1 [rad]", "at 1 [rad]"), rows)


def term_cells(term: Term) -> tuple[str, ...]:
    """A term's row under `TERM_HEAD`."""
    entries = ENTRIES.get(term.labels, ", ".join(term.labels))
    return f"`{term.name}`", entries, term.unit, span((term.low, term.high)), term.meaning


def placed(terms: Sequence[Term], start: int) -> Iterator[tuple[str, Term]]:
    """Consecutive terms of the observation vector, each with its place in words."""
    for term in terms:
        end = start + len(term.labels) - 1
        yield str(start) if end == start else f"{start}–{end}", term
        start = end + 1


def privileged_table() -> str:
    """Table of the privileged terms of all tasks, each once.

    Raises:
        ValueError: Tasks have terms of one name that differ in what a reader sees.
    """
    rows: dict[str, tuple[str, ...]] = {}
    for task in TASKS.values():
        for term in task.privileged_terms:
            if rows.setdefault(term.name, term_cells(term)) != term_cells(term):
                raise ValueError(f"privileged term '{term.name}' differs between tasks")
    return markdown(TERM_HEAD, rows.values())


def privileged_list(terms: Sequence[Term], start: int) -> str:
    """The privileged terms of a task with their places in the vector."""
    return f"{', '.join(f'`{term.name}` {place}' for place, term in placed(terms, start))}."


def term_table(terms: Sequence[Term], start: int = 0) -> str:
    """Table of consecutive terms of the observation vector."""
    rows = [(place, *term_cells(term)) for place, term in placed(terms, start)]
    return markdown(("index", *TERM_HEAD), rows)


def reward_table(task: Task) -> str:
    """Table of the terms of the dense reward."""
    rows = [(f"`{term.name}`", term.meaning) for term in task.reward_terms]
    return markdown(("term", "value"), rows)


def config_table(task: Task) -> str:
    """Table of the settings for sampling and judging episodes."""
    rows = [
        (f"`{field.name}`", span(getattr(task.config, field.name)), field.metadata["meaning"])
        for field in fields(task.config)
        if "meaning" in field.metadata
    ]
    return markdown(("name", "value", "meaning"), rows)


def phase_list(task: Task) -> str:
    """Sentence with the start time of each phase of a task."""
    begins: dict[str, float] = {}
    for step in range(task.control_steps):
        time = step / CONTROL_HZ
        begins.setdefault(task.phases[int(task.phase(np.array([time]))[0])], time)
    steps = [f"`{name}` from {begin:g} s" for name, begin in begins.items()]
    return f"{', '.join(steps)}; the end is at {task.duration:g} s."


def randomization_table() -> str:
    """Table of every quantity, its bounds, and its ranges in the presets."""
    presets = {name: preset for name, preset in PRESETS.items() if name != "nominal"}
    rows = []
    for quantity in fields(Randomization):
        told = quantity.metadata
        given = [getattr(preset, quantity.name) for preset in presets.values()]
        cells = ["–" if value == quantity.default else span(value) for value in given]
        rows.append((f"`{quantity.name}`", told["meaning"], span(told["bounds"]), *cells))
    return markdown(("name", "meaning", "bounds", *(f'"{name}"' for name in presets)), rows)


def object_table() -> str:
    """Table of the object of every grasp and its replacement in the shape variant."""
    rows = []
    for name, grasp in GRASPS.items():
        model = grasp.object
        sides = " × ".join(f"{1e3 * side:.3g}" for side in dict.fromkeys(model.size))
        mass = f"{1e3 * model.mass:.3g}"
        rows.append((f"`{name}`", model.about, sides, mass, grasp.variant("shape").object.about))
    return markdown(("grasp", "object", "size [mm]", "mass [g]", 'variant "shape"'), rows)


def task_tables(env_id: str) -> Makers:
    """Functions that make the tables of an id's page, by table name."""
    task = TASKS[env_id]
    deployed = sum(len(term.labels) for term in task.terms)
    own = [option for option in options_of_id(env_id) if option not in COMMON]
    makers: Makers = {
        "summary": lambda: summary_table(env_id, task),
        "observation": lambda: term_table(task.terms),
        "privileged": lambda: privileged_list(task.privileged_terms, deployed),
        "reward": lambda: reward_table(task),
        "arguments": lambda: option_table(own),
    }
    makers |= {
        name: lambda terms=terms: term_table(terms, deployed)
        for name, terms in task.sensed_terms.items()
        if terms
    }
    if task.goal_terms:
        return makers | {"goal": lambda: term_table(task.goal_terms)}
    return makers | {"start": lambda: config_table(task), "phases": lambda: phase_list(task)}


PAGE_OF_ALL: Makers = {
    "action": action_table,
    "privileged": privileged_table,
    "arguments": lambda: option_table([option for option in COMMON if option.name != "obs"]),
    "randomization": randomization_table,
}
"""Tables of what every environment has."""
