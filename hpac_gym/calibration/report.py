"""The report of `hpac calibrate`: as data, as Markdown, and its figure."""

from __future__ import annotations

from dataclasses import asdict, astuple
from typing import TYPE_CHECKING

import numpy as np

from hpac_gym.calibration.combinations import SweptDigit, values
from hpac_gym.calibration.file_errors import BOUND, FileError, expected_worst_deg, residuals
from hpac_gym.calibration.fitting import DigitFit
from hpac_gym.calibration.identification import Identification
from hpac_gym.calibration.samples import DigitSamples, held_out_rows
from hpac_gym.figures import GREEN, GREY, RED, label, new_figure
from hpac_gym.model import Hand
from hpac_gym.output import markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SAME_SWEEP = (
    "at the held-out points of the same sweep (an error of camera or servos that lasts all along is not in it: --check "
    "a second sweep)"
)
EFFECTIVE = (
    "The numbers are effective ones: in this combination they make the measured angles. What the fit does not have (pins, play, "
    "the camera's scale) is in them, so none has an interval, and none is the hand's own."
)


def summary(
    identified: Identification,
    base: Hand,
    errors: dict[str, FileError],
    remarks: list[str],
    checked: bool = False,
) -> dict[str, object]:
    """The contents of the report as data; `checked` says that the errors are of a second sweep.

    The ends of an estimate hold if the hand obeys the laws of the fit."""
    worst = expected_worst_deg(errors) if checked and errors else None
    return {
        "base": base.name,
        "expected_worst_deg": worst,
        "bound_95_deg": worst and BOUND * worst,
        "digits": {
            name: {
                "effective_numbers": {item.name: asdict(item) for item in fit.estimates},
                "friction": asdict(fit.swept.friction),
                "servo_zero_deg": float(np.degrees(fit.swept.servo_zero)),
                "misfit": fit.misfit,
                "samples": fit.samples.samples,
                "outliers": fit.samples.outliers,
                "stops_rad": fit.samples.stops,
                "points_at_stops": fit.samples.at_stops,
                "missing": list(fit.samples.missing),
            }
            for name, fit in identified.fits.items()
        },
        "cmc": {item.name: asdict(item) for item in identified.cmc or ()},
        "kept": identified.kept,
        "file_error": {name: asdict(error) for name, error in errors.items()},
        "remarks": remarks,
    }


def report(
    identified: Identification,
    base: Hand,
    errors: dict[str, FileError],
    remarks: list[str],
    second: str = "",
) -> str:
    """The report as Markdown; `second` is the name of the second sweep that the errors are of, if
    there is one.
    """
    lines = [f"# Calibration about {base.name}", ""]
    if errors:
        off = [error.mean_abs_deg for error in errors.values()]
        worst = expected_worst_deg(errors)
        first = (
            f"Judged on the independent sweep {second}, commands with the written file are off by {np.mean(off):.2f}° on average "
            f"and by {worst:.2f}° at the worst joint; with 95 % confidence by at most {BOUND * worst:.2f}°."
            if second
            else f"The error of the written file {SAME_SWEEP} is {np.mean(off):.3f}° on average and {max(off):.3f}° at the worst "
            "joint."
        )
        told = ("file, mean error [°]", "largest", "camera noise", "points")
        cells = {
            name: (*(f"{value:.3f}" for value in astuple(error)[:-1]), error.points)
            for name, error in errors.items()
        }
        lines += [
            first,
            "",
            markdown(("joint", *told), [(label(name), *row) for name, row in cells.items()]),
            "",
        ]
    lines += [EFFECTIVE, ""]
    for name, fit in identified.fits.items():
        lines += _digit_report(name, fit, base)
    if identified.cmc and identified.cmc_samples:
        gain, zero = identified.cmc
        lines += ["## thumb CMC", ""]
        lines += [f"Effective g_CMC {gain.value:.4f}, zero {np.degrees(zero.value):.2f}°."]
        lines += [*_stops(identified.cmc_samples), ""]
    lines += [
        f"{name} keeps the design's parameters: {why}." for name, why in identified.kept.items()
    ]
    lines += [f"Remark: {remark}{'' if remark.endswith('?') else '.'}" for remark in remarks]
    return "\n".join(lines) + "\n"


def _digit_report(name: str, fit: DigitFit, base: Hand) -> list[str]:
    head = ("effective number", "formula", "design", "found", "determined by the data")
    rows = [
        (
            item.name,
            item.formula,
            f"{nominal:.4g}",
            f"{item.value:.4g}",
            f"{item.told:.0%}",
        )
        for item, nominal in zip(fit.estimates, values(SweptDigit(base.digits[name])), strict=True)
    ]
    lines = [f"## {name}", "", markdown(head, rows)]
    samples = fit.samples
    lines += [
        "",
        f"{samples.samples} samples, {samples.outliers} of them outliers. The points scatter {fit.misfit:.2f} times "
        f"as much about the fit as expected from their samples.",
    ]
    lines += _stops(samples)
    lines += [f"Not measured: {', '.join(samples.missing)}."] if samples.missing else []
    return [*lines, ""]


def _stops(samples: DigitSamples) -> list[str]:
    return [
        f"{joint} rests at {angle:.3f} rad: it, or another joint of the digit, is at a stop. {samples.at_stops} points "
        "are left out; the file's workspace ends there."
        for joint, angle in samples.stops.items()
    ]


def fit_figure(identified: Identification, base: Hand, written: Hand) -> Figure:
    """Residuals of the points for the design and for the written file, joint by joint; held-out
    points are rings.
    """
    designed, table = (residuals(identified.samples, hand) for hand in (base, written))
    rows = -(-len(table) // 5)
    figure = new_figure(13, 3 * rows)
    axes = list(figure.subplots(rows, min(len(table), 5), squeeze=False).flat)
    for axis, (name, (samples, rest)) in zip(axes, table.items(), strict=False):
        angle = np.degrees(samples.servo)
        out = held_out_rows(samples)
        axis.plot(
            angle, np.degrees(designed[name][1]), ".", color=RED, markersize=4, label="design"
        )
        axis.plot(
            angle[~out],
            np.degrees(rest[~out]),
            ".",
            color=GREEN,
            markersize=4,
            label="file, fitted points",
        )
        axis.plot(
            angle[out],
            np.degrees(rest[out]),
            "o",
            color=GREEN,
            markersize=4,
            fillstyle="none",
            label="file, held-out points",
        )
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        axis.set_title(label(name), fontsize=9)
    for axis in axes[len(table) :]:
        axis.set_axis_off()
    figure.supxlabel("servo angle u [°]")
    figure.supylabel("measured − predicted [°]")
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside right upper", frameon=False
    )
    return figure
