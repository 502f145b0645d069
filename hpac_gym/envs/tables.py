"""The tables of ``docs/environments`` and ``docs/grasps.md``, from the code: ``python -m hpac_gym.envs.tables`` writes them.

A table stands between ``<!-- NAME -->`` and ``<!-- /NAME -->``; all else in the page is written by hand.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import get_args

import gymnasium

from hpac_gym.envs import posture
from hpac_gym.envs.arguments import arguments_of
from hpac_gym.envs.grasp import Grasp, GraspConfig
from hpac_gym.envs.grasp_data import GRASPS
from hpac_gym.envs.hand_env import CONTROL_HZ
from hpac_gym.envs.observation import Field, deployed_fields
from hpac_gym.envs.pick_place import PickPlace, PickPlaceConfig
from hpac_gym.envs.randomization import BOUNDS, PRESETS, Randomization
from hpac_gym.envs.task import Task
from hpac_gym.envs.views import PRIVILEGED_FIELDS, Obs
from hpac_gym.model import HPAC, SERVOS
from hpac_gym.sim import ObjectModel

DOCS = Path(__file__).parents[2] / "docs"


def table(head: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def summary_table(env_id: str) -> str:
    """What people look for first."""
    steps = episode_steps(env_id)
    rows = [["make", f'`gymnasium.make("hpac_gym:{env_id}")`']]
    for obs in get_args(Obs):
        with gymnasium.make(env_id, obs=obs) as env:
            if len(rows) == 1:
                rows.append(["action space", f"`{env.action_space}`"])
            rows.append([f'observation space, `obs="{obs}"`', f"`{space_in_words(env.observation_space)}`"])
    rows.append(["length", f"{steps} steps, {steps / CONTROL_HZ:g} s"])
    return table(["", ""], rows)


def episode_steps(env_id: str) -> int:
    """How long an episode lasts at most: by the time limit of the id, or by its task's own timetable."""
    limit = gymnasium.spec(env_id).max_episode_steps
    if limit is not None:
        return limit
    with gymnasium.make(env_id) as env:
        return round(env.unwrapped.task.timetable.duration * CONTROL_HZ)


def space_in_words(space: gymnasium.Space) -> str:
    """A space without the bounds of every entry."""
    if isinstance(space, gymnasium.spaces.Dict):
        return f"Dict({', '.join(f'{name}: {space_in_words(part)}' for name, part in space.items())})"
    return f"Box({space.shape}, {space.dtype})"


def argument_table(env_id: str) -> str:
    """What an id takes."""
    rows = [[f"`{given.name}`", given.values, given.shown_default, given.meaning] for given in arguments_of(env_id)]
    return table(["argument", "values", "default", "meaning"], rows)


def action_table() -> str:
    """What the six numbers of an action mean."""
    rows = [
        [str(index), f"`{name}`", f"{HPAC.synergy_min[index]:.4g}", f"{HPAC.synergy_max[index]:.4g}"]
        for index, name in enumerate(SERVOS)
    ]
    return table(["index", "joint that the servo drives", "at −1 [rad]", "at 1 [rad]"], rows)


def field_table(described: tuple[Field, ...], start: int = 0) -> str:
    """A run of the observation vector."""
    rows = []
    for field in described:
        end = start + len(field.labels) - 1
        index = str(start) if end == start else f"{start}–{end}"
        labels = ", ".join(field.labels)
        rows.append([index, f"`{field.name}`", labels, field.unit, f"{field.low:g} … {field.high:g}", field.meaning])
        start = end + 1
    return table(["index", "field", "entries", "unit", "bounds", "meaning"], rows)


def task_fields(task: Task) -> tuple[Field, ...]:
    """The deployed observation of a task."""
    return deployed_fields(task.timetable.phases, task.fields)


def length_of(described: tuple[Field, ...]) -> int:
    """How many entries a table describes."""
    return sum(len(field.labels) for field in described)


def reward_list(task: type) -> str:
    """The terms of a task's dense reward, from where they are computed."""
    text = inspect.getdoc(task.reward_terms) or ""
    return text[text.index("* ") :].strip()


def range_table(config: type) -> str:
    """The ranges that an episode is drawn from, with the documentation of each."""
    documents, defaults, rows = attribute_docs(config), config(), []
    for field in fields(config):
        value = getattr(defaults, field.name)
        if isinstance(value, tuple):
            value = f"{value[0]:g} … {value[1]:g}"
        if isinstance(value, str | float):
            rows.append([f"`{field.name}`", f"{value}", documents.get(field.name, "")])
    return table(["name", "value", "meaning"], rows)


def timetable_list(task: Task) -> str:
    """When each phase of a task begins."""
    timetable, steps = task.timetable, []
    begins = dict.fromkeys(timetable.phases)
    for step in range(round(timetable.duration * CONTROL_HZ)):
        name = timetable.phases[timetable.phase(step / CONTROL_HZ)]
        begins[name] = step / CONTROL_HZ if begins[name] is None else begins[name]
    steps = [f"`{name}` from {begin:g} s" for name, begin in begins.items()]
    return f"{', '.join(steps)}; the end is at {timetable.duration:g} s."


def randomization_table() -> str:
    """Every quantity, what it may be, and what the presets make of it."""
    documents = attribute_docs(Randomization)
    rows = []
    for name in BOUNDS:
        given = [getattr(preset, name) for key, preset in PRESETS.items() if key != "nominal"]
        nominal = getattr(PRESETS["nominal"], name)
        cells = ["–" if value == nominal else f"{value[0]:g} … {value[1]:g}" for value in given]
        rows.append([f"`{name}`", *cells, documents[name]])
    return table(["name", *(f'"{key}"' for key in PRESETS if key != "nominal"), "meaning; bounds"], rows)


def object_table() -> str:
    """The object of every grasp, what its source prints of it, and what takes its place in the variant of shape."""
    rows = []
    for name, grasp in GRASPS.items():
        shape = grasp.variant("shape").object
        rows.append([f"`{name}`", *_measures(grasp.object), grasp.object.source, grasp.object.chosen, shape.about])
    return table(["grasp", "object", "size [mm]", "mass [g]", "source", "not published", 'variant "shape"'], rows)


def _measures(model: ObjectModel) -> list[str]:
    sides = (f"{1e3 * side:.3g}" for side in dict.fromkeys(model.size))
    return [model.about, " × ".join(sides), f"{1e3 * model.mass:.3g}"]


def attribute_docs(kind: type) -> dict[str, str]:
    """The text below each attribute of a class; a text speaks for those above it that have none."""
    pattern = re.compile(r'^    (\w+): [^\n]*\n(?:    """(.*?)""")?', re.MULTILINE | re.DOTALL)
    return {name: " ".join(text.split()) for name, text in pattern.findall(inspect.getsource(kind))}


Makers = dict[str, Callable[[], str]]


def task_tables(env_id: str, task: type, config: type) -> Makers:
    """The tables of a task in front of `HandEnv`."""
    return {
        "summary": lambda: summary_table(env_id),
        "action": action_table,
        "observation": lambda: field_table(task_fields(task())),
        "privileged": lambda: field_table(PRIVILEGED_FIELDS, length_of(task_fields(task()))),
        "reward": lambda: reward_list(task),
        "start": lambda: range_table(config),
        "phases": lambda: timetable_list(task()),
        "arguments": lambda: argument_table(env_id),
    }


PAGES: dict[str, Makers] = {
    "environments/README.md": {"randomization": randomization_table},
    "environments/grasp.md": task_tables("HPAC-Grasp-v0", Grasp, GraspConfig),
    "environments/pick_place.md": task_tables("HPAC-PickPlace-v0", PickPlace, PickPlaceConfig),
    "environments/posture.md": {
        "summary": lambda: summary_table("HPAC-Posture-v0"),
        "action": action_table,
        "observation": lambda: field_table(posture.FIELDS),
        "privileged": lambda: field_table(posture.PRIVILEGED_FIELDS, length_of(posture.FIELDS)),
        "goal": lambda: field_table(posture.GOAL_FIELDS),
        "arguments": lambda: argument_table("HPAC-Posture-v0"),
    },
    "grasps.md": {"objects": object_table},
}
"""Which tables every page in `DOCS` has, by their names."""


def filled(page: str, tables: Makers) -> str:
    """The page with every table as the code has it.

    Raises:
        ValueError: The page has no place for a table.
    """
    for name, make in tables.items():
        begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page needs '{begin}' and '{end}' once")
        before, rest = page.split(begin)
        page = f"{before}{begin}\n{make()}\n{end}{rest.split(end)[1]}"
    return page


def main() -> None:
    for name, tables in PAGES.items():
        page = DOCS / name
        page.write_text(filled(page.read_text(encoding="utf-8"), tables), encoding="utf-8")


if __name__ == "__main__":
    main()
