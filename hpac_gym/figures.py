"""Figures of Matplotlib: colours, names of joints, files."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from hpac_gym.output import OutputError, replacing, writable_file

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Of Okabe and Ito: people who do not see red and green apart can tell them.
RED = "#d55e00"
GREEN = "#009e73"
BLUE = "#0072b2"
CYCLE = (BLUE, "#e69f00", GREEN, "#cc79a7", "#56b4e9", RED, "#000000")
"""Colours of lines that a figure does not choose."""
GREY = "#7f8c8d"


def label(joint: str) -> str:
    """Display name of a joint: ``index_dip`` → ``Index DIP``."""
    digit, _, part = joint.partition("_")
    return f"{digit.capitalize()} {part.upper()}"


def require(path: str | os.PathLike[str] | None = None) -> None:
    """Import Matplotlib and check the path of a picture, if one is given, so that a command that
    draws at its end fails at its beginning.

    Raises:
        ModuleNotFoundError: It is not installed.
        OutputError: The path does not end in ``.png``, or cannot be written.
    """
    import matplotlib  # noqa: F401

    if path is not None:
        if Path(path).suffix.lower() != ".png":
            raise OutputError(f"a picture is written as .png, not as '{path}'")
        writable_file(Path(path))


def new_figure(width: float, height: float) -> Figure:
    """An empty figure [inch]; this imports Matplotlib, an extra."""
    from cycler import cycler
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    rcParams["axes.prop_cycle"] = cycler(color=CYCLE)
    return Figure(figsize=(width, height), layout="constrained")


def save(
    figure: Figure, path: str | os.PathLike[str], caption: str = "", picture: bool = False
) -> None:
    """Write a figure atomically as PNG and, with the same name, as SVG.

    Args:
        figure: the figure, without a title if there is a caption.
        path: path of the PNG.
        caption: hand, seed and record of the figure.
        picture: the figure consists of pixels, so no SVG is written.

    Raises:
        OutputError: A file cannot be written, or its name does not end in ``.png``.
    """
    require(path)
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    if caption:
        figure.suptitle(caption, fontsize=9, color=GREY)
    FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png", metadata={"Software": None})
    if not picture:
        with (
            replacing(Path(path).with_suffix(".svg")) as temporary,
            rc_context({"svg.hashsalt": "hpac", "svg.fonttype": "none"}),
        ):
            figure.savefig(temporary, format="svg", metadata={"Date": None, "Creator": None})
