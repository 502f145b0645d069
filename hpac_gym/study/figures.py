"""The figures of `hpac sweep`, and how every figure of the study is written."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from hpac_gym.output import replacing
from hpac_gym.study.accuracy import EVALUATED, Accuracy, Residuals

RED, GREEN, BLUE, GREY = "#c0392b", "#1e8449", "#2471a3", "#7f8c8d"
_KINDS = (("uncompensated", RED, "o"), ("compensated", GREEN, "s"))


def label(joint: str) -> str:
    """A joint's name for people: ``index_dip`` → ``Index DIP``."""
    digit, _, part = joint.partition("_")
    return f"{digit.capitalize()} {part.upper()}"


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


def residual_figure(found: Mapping[str, Residuals]) -> Figure:
    """The paper's residual figure: nine joints over their servo's angle, red uncompensated, green compensated.

    The axis shows ±2° as the paper's does, or more where the data needs it. Single points far from all others are left out of
    the axis and counted in the panel's title.
    """
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(3, 3, sharey=True).flat
    limit = residual_limit(found)
    for axis, name in zip(axes, EVALUATED, strict=True):
        axis.set_title(label(name), fontsize=10)
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        axis.set_ylim(-limit, limit)
        if name not in found:
            axis.text(0.5, 0.5, "not measured", transform=axis.transAxes, ha="center", color=GREY)
            continue
        beyond = 0
        for kind, color, marker in _KINDS:
            values = np.degrees(getattr(found[name], kind))
            beyond += int((np.abs(values) > limit).sum())
            axis.plot(np.degrees(found[name].servo), values, marker, color=color, markersize=3, label=kind)
        if beyond:
            axis.set_title(f"{label(name)} ({beyond} points beyond ±{limit:g}° left out)", fontsize=9)
    figure.supxlabel("servo angle u [°]")
    figure.supylabel("residual q_meas − q_model [°]")
    handles, labels = next(axis.get_legend_handles_labels() for axis in figure.axes if axis.get_legend_handles_labels()[0])
    figure.legend(handles, labels, loc="outside right upper", frameon=False)
    return figure


def residual_limit(found: Mapping[str, Residuals]) -> float:
    """Half of the residual figure's axis: the paper's 2°, or a round number that holds 98 % of all points [°]."""
    values = np.concatenate([np.degrees(np.abs(getattr(found[name], kind))) for name in found if name in EVALUATED
                             for kind, *_ in _KINDS])  # fmt: skip
    needed = float(np.quantile(values, 0.98))
    if float(values.max()) <= 1.5 * needed:
        needed = float(values.max())
    steps = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 60.0, 180.0)
    return next(step for step in steps if step >= needed)


def mae_figure(errors: Accuracy) -> Figure:
    """The paper's bar figure: mean absolute error of each joint, red without and green with compensation.

    MP and MCP stand beside the nine joints as in the paper; the model does not compensate them, so their bars are equal.
    """
    names = list(errors.mae_deg["uncompensated"])
    figure = Figure(figsize=(13, 4), layout="constrained")
    axis = figure.subplots()
    for shift, (kind, color, _) in zip((-0.2, 0.2), _KINDS, strict=True):
        values = [errors.mae_deg[kind][name] for name in names]
        bars = axis.bar(np.arange(len(names)) + shift, values, 0.38, color=color, label=kind)
        axis.bar_label(bars, fmt="%.2f", fontsize=8)
    axis.set_xticks(np.arange(len(names)), [label(name) for name in names], rotation=25)
    axis.set_ylabel("mean absolute error [°]")
    axis.legend(frameon=False)
    return figure
