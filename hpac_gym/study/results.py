"""Results of the experiments: means and ranges, tables for people, the same numbers for programs, and figures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator
from numpy.typing import ArrayLike

from hpac_gym.output import replacing

RED, GREEN, BLUE, GREY = "#c0392b", "#1e8449", "#2471a3", "#7f8c8d"


@dataclass(frozen=True, slots=True)
class Mean:
    """A mean over trials or seeds, and the 95 % interval of Student's t; NaN bounds for a single one."""

    mean: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} [{self.low:.3f}, {self.high:.3f}]"


def mean_of(values: ArrayLike) -> Mean:
    """The mean of independent values, shape (n,)."""
    values = np.asarray(values, dtype=float)
    centre = float(values.mean())
    if len(values) < 2:
        return Mean(centre, float("nan"), float("nan"))
    from scipy import stats  # takes half a second to load

    half = float(stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))
    return Mean(centre, centre - half, centre + half)


@dataclass(frozen=True, slots=True)
class Range:
    """Median and the middle 95 % of a population."""

    median: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.median:.2f} [{self.low:.2f}, {self.high:.2f}]"


def range_of(values: ArrayLike) -> Range:
    """The range of a population, shape (n,)."""
    return Range(*np.quantile(values, (0.5, 0.025, 0.975)).tolist())


@dataclass(frozen=True, slots=True)
class Part:
    """One part's result."""

    text: str
    """Markdown."""
    data: object
    """For the JSON file: of numbers, texts, lists, mappings and dataclasses."""
    figures: Mapping[str, Figure] = field(default_factory=dict)
    """By file name without its ending."""
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Column:
    """One number of every row of a table."""

    key: str
    """Its name in the JSON file."""
    heading: str
    """Its name on the page."""
    value: Callable[[Any], object]
    """Takes it from what was found for the row."""
    form: str = "{}"
    """How the page writes it."""


def rows_of(columns: Sequence[Column], found: Mapping[str, Any]) -> dict[str, dict[str, object]]:
    """The numbers of a table's rows by key, from what was found for each row."""
    return {name: {column.key: column.value(item) for column in columns} for name, item in found.items()}


def table(first: str, columns: Sequence[Column], rows: Mapping[str, Mapping[str, object]]) -> str:
    """The rows as a Markdown table; `first` is the heading of their names."""
    body = [(name, *(column.form.format(row[column.key]) for column in columns)) for name, row in rows.items()]
    return markdown((first, *(column.heading for column in columns)), body)


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table, its first column to the left and the others to the right."""
    lines = [f"| {' | '.join(head)} |", "|---|" + "--:|" * (len(head) - 1)]
    return "\n".join([*lines, *(f"| {' | '.join(map(str, row))} |" for row in rows)])


def label(joint: str) -> str:
    """A joint's name for people: ``index_dip`` → ``Index DIP``."""
    digit, _, part = joint.partition("_")
    return f"{digit.capitalize()} {part.upper()}"


def log_ticks(axis: Axis, ticks: Sequence[float]) -> None:
    """Make one of a plot's axes logarithmic, with these ticks alone."""
    axis.axes.set(**{f"{axis.axis_name}scale": "log"})
    axis.set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set_minor_locator(NullLocator())


def save(figure: Figure, path: str | os.PathLike[str], caption: str = "", picture: bool = False) -> None:
    """Write a figure, whole or not at all, as PNG and beside it as SVG.

    Args:
        figure: without a title of its own where there is a caption.
        path: of the PNG.
        caption: which hand, seed and record the figure shows.
        picture: made of pixels, so that an SVG would only be larger.

    Raises:
        OutputError: A file cannot be written.
    """
    if caption:
        figure.suptitle(caption, fontsize=9, color=GREY)
    FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png", metadata={"Software": None})
    if not picture:
        with replacing(Path(path).with_suffix(".svg")) as temporary, rc_context({"svg.hashsalt": "hpac", "svg.fonttype": "none"}):
            figure.savefig(temporary, format="svg", metadata={"Date": None, "Creator": None})
