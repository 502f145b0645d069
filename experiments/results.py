"""Results of the experiments: means and ranges, Markdown tables, JSON data, and figures."""

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from numpy.typing import ArrayLike

from hpac_gym.command import whole_number
from hpac_gym.evaluation.statistics import paired_difference, success_counts
from hpac_gym.output import OutputError, markdown, read_text, writable_file, write_text


@dataclass(frozen=True, slots=True)
class Interval:
    """A middle value between two bounds. A format such as ``.2f`` applies to all three; ``str``
    shows three decimals.
    """

    middle: float
    low: float
    high: float

    def __format__(self, form: str) -> str:
        return f"{self.middle:{form}} [{self.low:{form}}, {self.high:{form}}]"

    def __str__(self) -> str:
        return f"{self:.3f}"


def mean_of(values: ArrayLike) -> Interval:
    """Mean of independent values, shape (n,), with its 95 % Student's t interval; the bounds of a
    single value are NaN.
    """
    values = np.asarray(values, dtype=float)
    centre = float(values.mean())
    half = float("nan")
    if len(values) > 1:
        from scipy import stats  # takes half a second to load

        half = float(
            stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values))
        )
    return Interval(centre, centre - half, centre + half)


def compared(held: Sequence[bool], others: Sequence[bool]) -> dict[str, Any]:
    """Counts of successes, as of `success_counts`, and the difference from others over the same
    episodes.
    """
    difference, *interval = paired_difference(held, others)
    return {
        **success_counts(sum(held), len(held)),
        "difference": difference,
        "difference_95": interval,
    }


def percent(bounds: Sequence[float], form: str = ".1f") -> str:
    """Text of the bounds of a share [%]."""
    return f"[{', '.join(f'{100 * bound:{form}}' for bound in bounds)}]"


def range_of(values: ArrayLike) -> Interval:
    """Median and middle 95 % of a population, shape (n,)."""
    return Interval(*np.quantile(values, (0.5, 0.025, 0.975)).tolist())


@dataclass(frozen=True, slots=True)
class Part:
    """Result of one part."""

    text: str
    """Report in Markdown."""
    data: object
    """Contents of the JSON file: numbers, strings, lists, mappings and dataclasses."""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    """Figures by file name without extension."""
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table."""

    key: str
    """Name in the JSON file."""
    heading: str
    """Heading in the Markdown table."""
    value: Callable[[Any], object]
    """Function of a row's result that returns the value."""
    form: str = "{}"
    """Format in the Markdown table."""


def rows_of(columns: Sequence[Column], found: Mapping[str, Any]) -> dict[str, dict[str, object]]:
    """Values of a table's rows by key, computed from the result of each row."""
    return {
        name: {column.key: column.value(item) for column in columns} for name, item in found.items()
    }


def table(first: str, columns: Sequence[Column], rows: Mapping[str, Mapping[str, object]]) -> str:
    """The rows as a Markdown table; `first` is the heading of the first column."""
    body = [
        (name, *(column.form.format(row[column.key]) for column in columns))
        for name, row in rows.items()
    ]
    return markdown((first, *(column.heading for column in columns)), body)


def part_of(
    title: str, first: str, columns: Sequence[Column], found: Mapping[str, Any], **more: Any
) -> Part:
    """The part whose report is one table and whose data are its rows; `more` are its figures and their
    caption.
    """
    rows = rows_of(columns, found)
    return Part(f"## {title}\n\n{table(first, columns, rows)}\n", rows, **more)


def log_ticks(axis: Axis, ticks: Sequence[float]) -> None:
    """Make one axis of a plot logarithmic, with only the given ticks."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_minor_locator(NullLocator())


def add_workers_and_out(parser: argparse.ArgumentParser) -> None:
    """The arguments ``--workers`` and ``--out`` of an experiment that runs episodes."""
    parser.add_argument("--workers", type=whole_number(1), default=os.cpu_count() or 1)
    add_out(parser)


def add_out(parser: argparse.ArgumentParser) -> None:
    """The argument ``--out`` of an experiment, not the committed results by default; a file that
    cannot be written is refused before hours of work.
    """
    out = f"runs/experiments/{parser.prog.rpartition('.')[2]}.json"
    parser.add_argument(
        "--out", type=_writable, default=out, metavar="JSON", help="file of the results"
    )


def _writable(name: str) -> Path:
    path = Path(name)
    writable_file(path)
    return path


def write_results(path: Path, words: str, **data: object) -> None:
    """Write the data of an experiment as JSON, after its command.

    Args:
        path: the file.
        words: of the command, after ``python -m experiments.``.
        data: numbers, strings, lists, mappings and dataclasses, by name.
    """
    told = {"command": f"python -m experiments.{words}", **data}
    write_text(path, json.dumps(told, indent=1, default=asdict) + "\n")


def read_results(path: Path, *names: str) -> dict[str, Any]:
    """The data that `write_results` wrote, which has at least these names.

    Raises:
        OutputError: The file cannot be read, is damaged, or lacks a name.
    """
    try:
        data = json.loads(read_text(path, "results", OutputError))
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, dict) or set(names) - set(data):
        raise OutputError(
            f"results '{path}' are damaged, or of another experiment: they lack {', '.join(names)}"
        )
    return data
