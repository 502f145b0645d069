"""The report of `hpac calibrate`: the errors of the written hand file at points of a sweep, what they
promise for commands, all of it as data and as Markdown, and a figure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass
from typing import TYPE_CHECKING

import numpy as np

from hpac_gym.calibration.combinations import SweptDigit, values
from hpac_gym.calibration.fitting import DigitFit
from hpac_gym.calibration.identification import Identification
from hpac_gym.calibration.record import Sweep
from hpac_gym.calibration.samples import DigitSamples, digit_samples, held_out_rows
from hpac_gym.figures import GREEN, GREY, RED, label, new_figure
from hpac_gym.model import JOINT_INDEX, JOINTS, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import EXTENSION, FLEXION, settled_joints_from_servo
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

WORST_OF_JOINTS = 1.7
"""Error of the worst joint relative to the root mean square over the joints, in the median hand."""
BOUND = 2.2
"""Bound of the worst joint's error with 95 % confidence, relative to the expected one: the errors of
the two sweeps' cameras and warm-ups may cancel by chance.

Both were chosen on simulated hands with everything missing from the model at once, and judged on
others (`experiments.imperfect`)."""
CHECK_DOUBT_DEG = 1.5
"""Error in the second sweep above which the two sweeps contradict each other [°], chosen: those hands
reach 1.2°.
"""


@dataclass(frozen=True, slots=True)
class FileError:
    """Error of the written file for one joint, at the held-out points."""

    mean_abs_deg: float
    max_deg: float
    noise_deg: float
    """Standard deviation of one camera sample."""
    points: int


def residuals(
    by_servo: Mapping[int, DigitSamples], hand: Hand
) -> dict[str, tuple[DigitSamples, Array]]:
    """Measured minus predicted angles by joint: the digit's samples and the residuals (k,) [rad].

    Args:
        by_servo: the samples of every swept servo, by its index.
        hand: the hand that predicts.
    """
    table: dict[str, tuple[DigitSamples, Array]] = {}
    for column, samples in by_servo.items():
        servo = np.zeros((len(samples.servo), len(SERVOS)))
        servo[:, column] = samples.servo
        flexed = settled_joints_from_servo(servo, hand, FLEXION)
        extended = settled_joints_from_servo(servo, hand, EXTENSION)
        predicted = np.where(samples.direction[:, None] == FLEXION, flexed, extended)
        for i, joint in enumerate(samples.joints):
            if joint not in samples.missing:
                rest = samples.joint_pos[:, i] - predicted[:, JOINT_INDEX[joint]]
                table[joint] = samples, rest
    return {name: table[name] for name in JOINTS if name in table}


def file_errors(identified: Identification, written: Hand) -> dict[str, FileError]:
    """Errors at the held-out points, by joint."""
    held_out = {
        servo: samples.only(held_out_rows(samples)) for servo, samples in identified.samples.items()
    }
    return _errors(held_out, written)


def check_errors(second: Sweep, written: Hand, base: Hand) -> dict[str, FileError]:
    """Errors at all the points of an independent sweep, by joint."""
    by_servo = {servo: digit_samples(second, servo, base) for servo in range(len(SERVOS))}
    return _errors({servo: samples for servo, samples in by_servo.items() if samples}, written)


def _errors(by_servo: Mapping[int, DigitSamples], written: Hand) -> dict[str, FileError]:
    """Errors by joint; joints without a measurement at these points are left out."""
    errors = {}
    for name, (samples, rest) in residuals(by_servo, written).items():
        off = np.degrees(np.abs(rest[~np.isnan(rest)]))
        if off.size:
            noise = np.degrees(samples.noise[samples.joints.index(name)])
            errors[name] = FileError(float(off.mean()), float(off.max()), float(noise), off.size)
    return errors


def expected_worst_deg(errors: Mapping[str, FileError]) -> float:
    """Expected error of commands at the worst joint, from the errors in a second sweep [°].

    The joint that is worst in one sweep is not in the next: the geometric mean of the largest error
    and of what the root mean square over the joints lets expect."""
    off = np.array([error.mean_abs_deg for error in errors.values()])
    return float(np.sqrt(off.max() * WORST_OF_JOINTS * np.sqrt((off**2).mean())))


def contradictions(errors: Mapping[str, FileError]) -> list[str]:
    """A remark if a second sweep contradicts the first, which the hand's own changes do not."""
    off = [label(name) for name, error in errors.items() if error.mean_abs_deg > CHECK_DOUBT_DEG]
    return [
        f"the two sweeps differ by more than {CHECK_DOUBT_DEG:g}° in {', '.join(off)}: in one of them the camera was not "
        "square, or a scale, a marker or a tendon's seat was another; look, and sweep again"
    ] * bool(off)


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
        told = ("joint", "file, mean error [°]", "largest", "camera noise", "points")
        rows = [
            (label(name), *(f"{value:.3f}" for value in astuple(error)[:-1]), error.points)
            for name, error in errors.items()
        ]
        lines += [first, "", markdown(told, rows), ""]
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
    for place, (name, (samples, rest)) in enumerate(table.items(), 1):
        axis = figure.add_subplot(rows, min(len(table), 5), place)
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
    figure.supxlabel("servo angle u [°]")
    figure.supylabel("measured − predicted [°]")
    figure.legend(*axis.get_legend_handles_labels(), loc="outside right upper", frameon=False)
    return figure
