"""Tables of ``docs``, generated from the code and from ``docs/results``; ``make generate`` writes
them.

A table stands between ``<!-- NAME -->`` and ``<!-- /NAME -->``; all else in the page is written by
hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from experiments.gap import gap_table
from hpac_gym.envs.options import COMMON
from hpac_gym.envs.randomization import PRESETS, Randomization
from hpac_gym.envs.registered import make_task, options_of_id
from hpac_gym.evaluation import results, splits
from hpac_gym.evaluation.closures import scale_of, share_found, winning_closures
from hpac_gym.evaluation.statistics import rate_text, wilson_interval
from hpac_gym.model import HPAC, JOINTS, SERVOS
from hpac_gym.output import markdown
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, IDS, PICK_PLACE, POSTURE
from hpac_gym.tasks.grasp_data import GRASPS
from hpac_gym.tasks.options import Option
from hpac_gym.tasks.task import CONTROL_HZ, Task
from hpac_gym.tasks.terms import Term
from tools.grasp_types import TABLES as TYPE_TABLES
from tools.grasp_types import all_successes_table

DOCS = Path(__file__).parents[1] / "docs"
TASKS: dict[str, Task] = {env_id: make_task(env_id) for env_id in IDS}
ENTRIES = {
    tuple(JOINTS): "15 joints",
    tuple(SERVOS): "6 servos",
}
"""Entries of a term that the page of all environments names."""


def span(values: Any) -> str:
    """Text of a range or of a single number."""
    return (
        " … ".join(f"{value:g}" for value in values) if isinstance(values, tuple) else f"{values:g}"
    )


def summary_table(env_id: str, task: Task) -> str:
    """Table of id, spaces and episode length."""
    rows = [["make", f'`gymnasium.make("hpac_gym:{env_id}")`']]
    for obs in task.observations:
        with gymnasium.make(env_id, obs=obs) as env:
            if len(rows) == 1:
                rows.append(["action space", f"`{env.action_space}`"])
            rows.append(
                [f'observation space, `obs="{obs}"`', f"`{space_in_words(env.observation_space)}`"]
            )
    return markdown(
        ["", ""],
        [*rows, ["length", f"{round(task.duration * CONTROL_HZ)} steps, {task.duration:g} s"]],
    )


def space_in_words(space: gymnasium.Space) -> str:
    """Text of a space without the bounds of its entries."""
    if isinstance(space, gymnasium.spaces.Dict):
        return (
            f"Dict({', '.join(f'{name}: {space_in_words(part)}' for name, part in space.items())})"
        )
    return f"Box({space.shape}, {space.dtype})"


def option_table(env_id: str) -> str:
    """Table of the arguments of an id that not every id has in the same way."""
    return _options([option for option in options_of_id(env_id) if option not in COMMON])


def common_option_table() -> str:
    """Table of the arguments that every id has, or every one with an object."""
    return _options([option for option in COMMON if option.name != "obs"])


def _options(options: Sequence[Option]) -> str:
    rows = [
        [f"`{option.name}`", values_of(option), shown(option.default), option.meaning]
        for option in options
    ]
    return markdown(["argument", "values", "default", "meaning"], rows)


def values_of(option: Option) -> str:
    """Values of an option; the sixteen grasps are listed on a separate page."""
    named = (
        ["None", "[a name](../grasps.md)"]
        if option.name == "grasp"
        else list(map(shown, option.values))
    )
    return ", ".join([*named, *filter(None, [option.others])])


def shown(value: Any) -> str:
    """Text of a value in Markdown."""
    if value is None or value is HPAC:
        return "None" if value is None else "`HPAC`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value!r}`"


def action_table() -> str:
    """Table of the six numbers of an action."""
    rows = [
        [
            str(index),
            f"`{name}`",
            f"{HPAC.synergy_min[index]:.4g}",
            f"{HPAC.synergy_max[index]:.4g}",
        ]
        for index, name in enumerate(SERVOS)
    ]
    return markdown(["index", "joint that the servo drives", "at −1 [rad]", "at 1 [rad]"], rows)


def privileged_terms() -> list[Term]:
    """The privileged terms of all tasks, each once.

    Raises:
        ValueError: Tasks have terms of one name that differ in what a reader sees.
    """
    by_name: dict[str, Term] = {}
    for task in TASKS.values():
        for term in task.privileged_terms:
            known = by_name.setdefault(term.name, term)
            if (known.labels, known.unit, known.low, known.high, known.meaning) != (
                term.labels,
                term.unit,
                term.low,
                term.high,
                term.meaning,
            ):
                raise ValueError(f"privileged term '{term.name}' differs between tasks")
    return list(by_name.values())


def privileged_table() -> str:
    """Table of the privileged terms of all tasks."""
    rows = [
        [
            f"`{term.name}`",
            ENTRIES.get(term.labels, ", ".join(term.labels)),
            term.unit,
            span((term.low, term.high)),
            term.meaning,
        ]
        for term in privileged_terms()
    ]
    return markdown(["field", "entries", "unit", "bounds", "meaning"], rows)


def privileged_list(terms: Sequence[Term], start: int) -> str:
    """The privileged terms of a task with their places in the vector."""
    parts = []
    for term in terms:
        end = start + len(term.labels) - 1
        parts.append(f"`{term.name}` {start}" if end == start else f"`{term.name}` {start}–{end}")
        start = end + 1
    return f"{', '.join(parts)}."


def term_table(terms: Sequence[Term], start: int = 0) -> str:
    """Table of consecutive terms of the observation vector."""
    rows = []
    for term in terms:
        end = start + len(term.labels) - 1
        index = str(start) if end == start else f"{start}–{end}"
        rows.append(
            [
                index,
                f"`{term.name}`",
                ENTRIES.get(term.labels, ", ".join(term.labels)),
                term.unit,
                span((term.low, term.high)),
                term.meaning,
            ]
        )
        start = end + 1
    return markdown(["index", "field", "entries", "unit", "bounds", "meaning"], rows)


def reward_table(task: Task) -> str:
    """Table of the terms of the dense reward."""
    return markdown(
        ["term", "value"], [[f"`{term.name}`", term.meaning] for term in task.reward_terms]
    )


def config_table(task: Task) -> str:
    """Table of the settings for sampling and judging episodes."""
    described = [field for field in fields(task.config) if "meaning" in field.metadata]
    rows = [
        [f"`{field.name}`", span(getattr(task.config, field.name)), field.metadata["meaning"]]
        for field in described
    ]
    return markdown(["name", "value", "meaning"], rows)


def phase_list(task: Task) -> str:
    """Sentence with the start time of each phase of a task."""
    begins: dict[str, float] = {}
    for step in range(round(task.duration * CONTROL_HZ)):
        time = step / CONTROL_HZ
        begins.setdefault(task.phases[int(task.phase(np.array([time]))[0])], time)
    steps = [f"`{name}` from {begin:g} s" for name, begin in begins.items()]
    return f"{', '.join(steps)}; the end is at {task.duration:g} s."


def randomization_table() -> str:
    """Table of every quantity, its bounds, and its ranges in the presets."""
    presets = {name: preset for name, preset in PRESETS.items() if name != "nominal"}
    rows = []
    for quantity in fields(Randomization):
        given = [getattr(preset, quantity.name) for preset in presets.values()]
        cells = ["–" if value == quantity.default else span(value) for value in given]
        rows.append(
            [
                f"`{quantity.name}`",
                quantity.metadata["meaning"],
                span(quantity.metadata["bounds"]),
                *cells,
            ]
        )
    return markdown(["name", "meaning", "bounds", *(f'"{name}"' for name in presets)], rows)


def object_table() -> str:
    """Table of the object of every grasp and its replacement in the shape variant."""
    rows = []
    for name, grasp in GRASPS.items():
        shape = grasp.variant("shape").object
        model = grasp.object
        sides = " × ".join(f"{1e3 * side:.3g}" for side in dict.fromkeys(grasp.object.size))
        rows.append(
            [
                f"`{name}`",
                model.about,
                sides,
                f"{1e3 * model.mass:.3g}",
                shape.about,
            ]
        )
    return markdown(
        ["grasp", "object", "size [mm]", "mass [g]", 'variant "shape"'],
        rows,
    )


def scale_table() -> str:
    """Table of the success of the best of n random closures on held-out seeds of `HPAC-Grasp-v0`,
    and its score.
    """
    tries = winning_closures()
    scale = scale_of(GRASP)
    rows = []
    for within in (1, 4, 16, 64, max(found.tries for found in tries)):
        won = round(share_found(tries, within) * len(tries))
        name = "a random closure: the floor" if within == 1 else f"best of {within} random closures"
        rows.append([name, rate_text(won, len(tries)), f"{scale.score(won / len(tries)):.2f}"])
    rows[-1][0] += ": the ceiling"
    return markdown([f"first {len(tries)} held-out seeds", "success", "score"], rows)


def result_files() -> dict[str, splits.Results]:
    """The benchmark's results files of the documentation, by name."""
    return {path.stem: results.read(path) for path in sorted((DOCS / "results").glob("*.json"))}


def results_table() -> str:
    """For each environment the success of every results file on every split, in percent."""
    tables = []
    for env_id in splits.SPLITS:
        files = {name: file for name, file in result_files().items() if file["env_id"] == env_id}
        if not files:
            continue
        rows = []
        for split in (*splits.SPLITS[env_id], "all splits"):
            cells = []
            for file in files.values():
                if split in splits.lacking(file):
                    cells.append("–")
                    continue
                (row,) = (row for row in file["summary"] if row["split"] == split)
                judged = [cell for cell in file["cells"] if cell["split"] == split]
                low, high = (judged[0] if len(judged) == 1 else row)["interval_95"]
                known = judged or file["budget"]
                interval = f" [{100 * low:.1f}, {100 * high:.1f}]" if known else ""
                cells.append(f"{100 * row['iqm']:.1f}{interval}")
            rows.append([split, *cells])
        head = [f"[{name.replace('_', ' ')}](results/{name}.json)" for name in files]
        tables.append(markdown([f"`{env_id}`", *head], rows))
    return "\n\n".join(tables)


def measured_page() -> str:
    """The page of the site with every table of ``docs/results`` and its command."""
    parts = [
        "# Every table",
        "Drawn from the data in `docs/results`. Each has the command that made it.",
        "## The benchmark's files",
    ]
    for name, file in result_files().items():
        parts += [f"### {name.replace('_', ' ')}", results.table(file), f"`{file['command']}`"]
    parts.append("## Measurements")
    for path in sorted((DOCS / "results" / "tables").glob("*.json")):
        table = json.loads(path.read_text(encoding="utf-8"))
        commands = [f"`{command.strip()}`" for command in table["command"].split("; ")]
        parts += [
            f"### {table['title']}",
            "  \n".join(commands),
            table["note"],
            markdown(table["head"], table["rows"]),
        ]
    parts += ["## Grasp types", "`python -m tools.grasp_types`"]
    for name, make in TYPE_TABLES.items():
        if name != "types":
            parts += [f"### {name}", make()]
    return "\n\n".join(parts) + "\n"


def deployed_table() -> str:
    """The cells of `experiments.deployed`."""
    file = DOCS / "results" / "experiments" / "deployed.json"
    rows = []
    for cell in json.loads(file.read_text(encoding="utf-8"))["cells"]:
        shares = []
        for where in ("environment", "wire"):
            low, high = (100 * bound for bound in cell[where]["interval_95"])
            shares.append(f"{cell[where]['success_rate']:.1%} [{low:.1f}, {high:.1f}]")
        low, high = (100 * bound for bound in cell["difference_95"])
        gain = f"{100 * cell['difference']:+.1f} [{low:+.1f}, {high:+.1f}]"
        refused = f"{cell['refused']:,} of {cell['moves']:,}"
        rows.append((cell["link"], *shares, gain, f"{cell['same_outcome']:.1%}", refused))
    head = ("link", "environment", "wire", "points", "same outcome", "refused commands")
    return markdown(head, rows)


def _gentle() -> dict[str, list[list[str]]]:
    """A row for every rule and kind of policy of `experiments.gentle`, by set-up; the runs of a
    kind, such as ``load-3``, are one row.
    """
    file = DOCS / "results" / "experiments" / "gentle.json"
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name, part in json.loads(file.read_text(encoding="utf-8")).items():
        what, _, where = name.partition("_")
        cells = {what: part} if "all" in part else part
        for label, cell in cells.items() if isinstance(part, dict) else ():
            if isinstance(cell, dict):
                kind = (where or "mujoco_light", label.partition("-")[0].replace(".", ", "))
                runs.setdefault(kind, []).append(cell)
    rows: dict[str, list[list[str]]] = {}
    for (where, label), cells in runs.items():
        row = [label if len(cells) == 1 else f"{label}, {len(cells)} seeds"]
        for limit in GENTLE_LIMITS:
            won, episodes = (
                sum(cell[limit][key] for cell in cells) for key in ("successes", "episodes")
            )
            low, high = (100 * bound for bound in wilson_interval(won, episodes))
            row.append(f"{100 * won / episodes:.0f} [{low:.0f}, {high:.0f}]")
        each = [100 * cell[GENTLE_LIMITS[1]]["success_rate"] for cell in cells]
        row.append(f"{min(each):.0f} … {max(each):.0f}" if len(each) > 1 else "")
        rows.setdefault(where, []).append(row)
    return rows


GENTLE_LIMITS = ("2.5 to 3 N", "3 to 4 N", "4 to 5 N", "all")


def gentle_table() -> str:
    """Successes by crush limit on the light body, of `experiments.gentle`."""
    return markdown(["policy", *GENTLE_LIMITS, "seeds, 3 to 4 N"], _gentle()["mujoco_light"])


def gentle_elsewhere_table() -> str:
    """Successes by crush limit on other bodies, engines, and where the limit is not told."""
    rows = []
    for where, made in _gentle().items():
        if where != "mujoco_light":
            place = where.replace("_untold", ", limit not told").replace("_", "/")
            rows += [[place, *row[:-1]] for row in made]
    return markdown(["where", "policy", *GENTLE_LIMITS], rows)


def seen_objects_table() -> str:
    """Errors of an object's pose, of `experiments.watched`."""
    rows = []
    for cell in _watched()["objects"]:
        errors = (cell["position_mm"], cell["rotation_deg"])
        missed = f"{cell['missed']} of {cell['pictures']}"
        rows.append((cell["lens"], missed, *(_quantiles(error) for error in errors)))
    head = ("camera", "missed", "position: p50, p95, max [mm]", "rotation: p50, p95, max [°]")
    return markdown(head, rows)


def seen_hands_table() -> str:
    """Errors of the angles of swept hands, of `experiments.watched`."""
    watched = _watched()
    rows: list[tuple[Any, ...]] = [
        (
            number,
            f"{cell['pictures']:,}",
            _quantiles(cell["angle_deg"]),
            f"{cell['exact_file_deg']:.3f}",
            f"{cell['file_deg']:.3f}",
        )
        for number, cell in enumerate(watched["hands"])
    ]
    cell = watched["thumbs"][-1]["a tooth back"]
    what = f"{len(rows) - 1}, thumb's horn a tooth back: the thumb"
    rows.append((what, cell["pictures"], _quantiles(cell["angle_deg"]), "", ""))
    head = (
        "hand",
        "pictures",
        "angle: p50, p95, max [°]",
        "file of the true angles [°]",
        "of the pictures [°]",
    )
    return markdown(head, rows)


def _watched() -> dict[str, Any]:
    file = DOCS / "results" / "experiments" / "watched.json"
    read: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return read


def _quantiles(error: dict[str, float]) -> str:
    return ", ".join(f"{value:.2f}" for value in error.values())


def gap_rows() -> str:
    """The cells of `experiments.gap`."""
    file = DOCS / "results" / "experiments" / "gap.json"
    return gap_table(json.loads(file.read_text(encoding="utf-8"))["cells"])


Makers = dict[str, Callable[[], str]]


def task_tables(env_id: str) -> Makers:
    """Functions that make the tables of an id's page, by table name."""
    task = TASKS[env_id]
    deployed = sum(len(term.labels) for term in task.terms)
    makers: Makers = {
        "summary": lambda: summary_table(env_id, task),
        "observation": lambda: term_table(task.terms),
        "privileged": lambda: privileged_list(task.privileged_terms, deployed),
        "reward": lambda: reward_table(task),
        "arguments": lambda: option_table(env_id),
    }
    more = {
        name: lambda terms=terms: term_table(terms, deployed)
        for name, terms in task.sensed_terms.items()
        if terms
    }
    makers |= more
    if task.goal_terms:
        return makers | {"goal": lambda: term_table(task.goal_terms)}
    return makers | {"start": lambda: config_table(task), "phases": lambda: phase_list(task)}


PAGES: dict[str, Makers] = {
    "environments/README.md": {
        "action": action_table,
        "privileged": privileged_table,
        "arguments": common_option_table,
        "randomization": randomization_table,
    },
    "environments/grasp.md": task_tables(GRASP) | {"scale": scale_table},
    "environments/grasp_any.md": task_tables(GRASP_ANY),
    "environments/grasp_type.md": task_tables(GRASP_TYPE),
    "environments/gentle.md": task_tables(GENTLE)
    | {"gentle": gentle_table, "gentle-elsewhere": gentle_elsewhere_table},
    "environments/pick_place.md": task_tables(PICK_PLACE),
    "environments/posture.md": task_tables(POSTURE),
    "benchmark.md": {"results": results_table},
    "camera.md": {"objects": seen_objects_table, "hands": seen_hands_table},
    "deploy.md": {"deployed": deployed_table, "gap": gap_rows},
    "grasps.md": {
        "objects": object_table,
        "types": TYPE_TABLES["types"],
        "success": all_successes_table,
    },
}
"""Tables of every page in `DOCS`, by name."""


def filled(page: str, tables: Makers) -> str:
    """The page with all its tables regenerated.

    Raises:
        ValueError: The page has no placeholder for a table.
    """
    for name, make in tables.items():
        begin = f"<!-- {name} -->"
        end = f"<!-- /{name} -->"
        if page.count(begin) != 1 or page.count(end) != 1:
            raise ValueError(f"the page needs '{begin}' and '{end}' once")
        before, rest = page.split(begin)
        page = f"{before}{begin}\n{make()}\n{end}{rest.split(end)[1]}"
    return page


def documents() -> dict[Path, str]:
    """All pages with regenerated tables."""
    return {
        DOCS / name: filled((DOCS / name).read_text(encoding="utf-8"), tables)
        for name, tables in PAGES.items()
    }
