"""The study's figures. Each function takes finished numbers and writes one PNG, whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
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


def save(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure as PNG, whole or not at all.

    Raises:
        OutputError: The file cannot be written.
    """
    FigureCanvasAgg(figure)
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png", metadata={"Software": None})


def residual_figure(found: Mapping[str, Residuals]) -> Figure:
    """The paper's residual figure: nine joints over their servo's angle, red uncompensated, green compensated, ±2°."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    axes = figure.subplots(3, 3, sharey=True).flat
    for axis, name in zip(axes, EVALUATED, strict=True):
        axis.set_title(label(name), fontsize=10)
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        axis.set_ylim(-2.0, 2.0)
        if name in found:
            for kind, color, marker in _KINDS:
                values = np.degrees(getattr(found[name], kind))
                axis.plot(np.degrees(found[name].servo), values, marker, color=color, markersize=3, label=kind, clip_on=False)
    figure.supxlabel("servo angle u [°]")
    figure.supylabel("residual q_meas − q_model [°]")
    handles, labels = figure.axes[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return figure


def mae_figure(errors: Accuracy) -> Figure:
    """The paper's bar figure: mean absolute error of each joint, red without and green with compensation."""
    names = list(errors.mae_deg["uncompensated"])
    figure = Figure(figsize=(11, 4), layout="constrained")
    axis = figure.subplots()
    for shift, (kind, color, _) in zip((-0.2, 0.2), _KINDS, strict=True):
        values = [errors.mae_deg[kind][name] for name in names]
        bars = axis.bar(np.arange(len(names)) + shift, values, 0.38, color=color, label=kind)
        axis.bar_label(bars, fmt="%.2f", fontsize=8)
    axis.set_xticks(np.arange(len(names)), [label(name) for name in names], rotation=25)
    axis.set_ylabel("mean absolute error [°]")
    axis.legend(frameon=False)
    return figure
