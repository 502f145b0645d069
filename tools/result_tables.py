"""Tables of the pages, from the data in ``docs/results``."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from experiments.results import mean_of, percent, read_results
from hpac_gym.evaluation import results, splits
from hpac_gym.evaluation.blind import score
from hpac_gym.evaluation.statistics import rate_text
from hpac_gym.output import markdown
from tools.blind_search import share_found, winning_closures

DOCS = Path(__file__).parents[1] / "docs"
GENTLE_LIMITS = ("2.5 to 3 N", "3 to 4 N", "4 to 5 N", "all")


def experiment(name: str) -> dict[str, Any]:
    """The data of an experiment."""
    return read_results(DOCS / "results" / "experiments" / f"{name}.json", "command")


def scale_table() -> str:
    """Table of the success of the best of n random closures on held-out seeds of `HPAC-Grasp-v0`,
    and its score.
    """
    tries = winning_closures()
    most = max(found.tries for found in tries)
    names = {
        1: "a random closure: the floor",
        **{n: f"best of {n} random closures" for n in (4, 16, 64)},
        most: f"best of {most} random closures: the ceiling",
    }
    rows = []
    for within, name in names.items():
        won = round(share_found(tries, within) * len(tries))
        rows.append((name, rate_text(won, len(tries)), f"{score(won / len(tries)):.2f}"))
    return markdown((f"first {len(tries)} held-out seeds", "success", "score"), rows)


def result_files() -> dict[str, splits.Results]:
    """The benchmark's results files of the documentation, by name."""
    return {path.stem: results.read(path) for path in sorted((DOCS / "results").glob("*.json"))}


def results_table() -> str:
    """For each environment the success of every results file on every split, in percent."""
    tables = []
    for env_id in splits.SPLITS:
        files = {name: file for name, file in result_files().items() if file["env_id"] == env_id}
        rows = [
            (split, *(_success(file, split) for file in files.values()))
            for split in (*splits.SPLITS[env_id], "all splits")
        ]
        head = [f"[{name.replace('_', ' ')}](results/{name}.json)" for name in files]
        tables += [markdown((f"`{env_id}`", *head), rows)] if files else []
    return "\n\n".join(tables)


def _success(file: splits.Results, split: str) -> str:
    """A results file's success on a split, with its interval where the runs have one."""
    if split in splits.lacking(file):
        return "–"
    (row,) = (row for row in file["summary"] if row["split"] == split)
    judged = [cell for cell in file["cells"] if cell["split"] == split]
    interval = percent((judged[0] if len(judged) == 1 else row)["interval_95"])
    return f"{100 * row['iqm']:.1f}" + (f" {interval}" if judged or file["budget"] else "")


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
        drawn = markdown(table["head"], table["rows"])
        parts += [f"### {table['title']}", "  \n".join(commands), table["note"], drawn]
    return "\n\n".join(parts) + "\n"


def _gentle() -> dict[str, list[tuple[str, ...]]]:
    """A row for every rule and kind of policy of `experiments.gentle`, by set-up; the runs of a
    kind, such as ``load-3``, are one row.
    """
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for name, part in experiment("gentle").items():
        what, _, where = name.partition("_")
        cells = {what: part} if "all" in part else part
        for label, cell in cells.items() if isinstance(part, dict) else ():
            if isinstance(cell, dict):
                kind = (where or "mujoco_light", label.partition("-")[0].replace(".", ", "))
                runs.setdefault(kind, []).append(cell)
    rows: dict[str, list[tuple[str, ...]]] = {}
    for (where, label), cells in runs.items():
        rows.setdefault(where, []).append(_gentle_row(label, cells))
    return rows


def _gentle_row(label: str, cells: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    if len(cells) == 1:
        (cell,) = cells
        shares = [
            f"{100 * cell[limit]['success_rate']:.0f} {percent(cell[limit]['interval_95'], '.0f')}"
            for limit in GENTLE_LIMITS
        ]
        return label, *shares, ""
    shares = [
        f"{mean_of([100 * cell[limit]['success_rate'] for cell in cells]):.0f}"
        for limit in GENTLE_LIMITS
    ]
    each = [100 * cell[GENTLE_LIMITS[1]]["success_rate"] for cell in cells]
    return f"{label}, {len(cells)} seeds", *shares, f"{min(each):.0f} … {max(each):.0f}"


def gentle_table() -> str:
    """Successes by crush limit on the light body, of `experiments.gentle`."""
    return markdown(("policy", *GENTLE_LIMITS, "seeds, 3 to 4 N"), _gentle()["mujoco_light"])


def gentle_elsewhere_table() -> str:
    """Successes by crush limit on other bodies, engines, and where the limit is not told."""
    rows = [
        (where.replace("_untold", ", limit not told").replace("_", "/"), *row[:-1])
        for where, made in _gentle().items()
        for row in made
        if where != "mujoco_light"
    ]
    return markdown(("where", "policy", *GENTLE_LIMITS), rows)


def seen_objects_table() -> str:
    """Errors of an object's pose, of `experiments.watched`."""
    rows = [
        (
            cell["lens"],
            f"{cell['missed']} of {cell['pictures']}",
            *_quantiles(cell, "position_mm", "rotation_deg"),
        )
        for cell in experiment("watched")["objects"]
    ]
    head = ("camera", "missed", "position: p50, p95, max [mm]", "rotation: p50, p95, max [°]")
    return markdown(head, rows)


def seen_hands_table() -> str:
    """Errors of the angles of swept hands, of `experiments.watched`."""
    watched = experiment("watched")
    rows: list[tuple[str, ...]] = []
    for number, cell in enumerate(watched["hands"]):
        files = (f"{cell[name]:.3f}" for name in ("exact_file_deg", "file_deg"))
        rows.append((str(number), f"{cell['pictures']:,}", *_quantiles(cell, "angle_deg"), *files))
    cell = watched["thumbs"][-1]["a tooth back"]
    what = f"{len(rows) - 1}, thumb's horn a tooth back: the thumb"
    rows.append((what, str(cell["pictures"]), *_quantiles(cell, "angle_deg"), "", ""))
    files = ("file of the true angles [°]", "of the pictures [°]")
    return markdown(("hand", "pictures", "angle: p50, p95, max [°]", *files), rows)


def _quantiles(cell: Mapping[str, Mapping[str, float]], *names: str) -> Iterator[str]:
    for name in names:
        yield ", ".join(f"{value:.2f}" for value in cell[name].values())
