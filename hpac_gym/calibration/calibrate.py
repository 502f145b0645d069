"""``hpac calibrate``: a hand file from a sweep of the hand, with a report of what the record can
identify.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, astuple, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hpac_gym.calibration.combinations import SweptDigit, values
from hpac_gym.calibration.doubts import doubts
from hpac_gym.calibration.fitting import DigitFit
from hpac_gym.calibration.identification import SPREAD, Identification, identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.posterior import DRAWS, report_folder, write_draws
from hpac_gym.calibration.record import Sweep, read_sweep
from hpac_gym.calibration.samples import HELD_OUT_EVERY, DigitSamples, digit_samples, held_out_rows
from hpac_gym.figures import GREEN, GREY, RED, label, new_figure, require, save
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Hand, hand_to_toml, load_hand
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import EXTENSION, FLEXION, settled_joints_from_servo
from hpac_gym.output import markdown, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OUT = Path("runs/calibrate/hand.toml")
SAME_SWEEP = (
    "at the held-out points of the same sweep (an error of camera or servos that lasts all along is not in it: --check "
    "a second sweep)"
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
EFFECTIVE = (
    "The numbers are effective ones: in this combination they make the measured angles. What the fit does not have (pins, play, "
    "the camera's scale) is in them, so none has an interval, and none is the hand's own."
)
_IDENTIFIED = (
    "d2",
    "alpha_deg",
    "servo_radius",
    "joint_radius",
    "path_length",
    "drive_stiffness",
    "cmc_gain",
    "calibration",
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument(
        "record",
        type=Path,
        metavar="sweep.csv",
        help="the record; columns of unmeasured joints may be absent",
    )
    parser.add_argument(
        "--check",
        type=Path,
        metavar="sweep2.csv",
        help="a second sweep, set up anew, on which the file is judged",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=OUT,
        metavar="FILE",
        help="hand file, its report beside it (%(default)s)",
    )
    parser.add_argument(
        "--base", type=Path, metavar="FILE", help="the hand's design (default: the nominal hand)"
    )
    parser.add_argument(
        "--spread",
        type=float,
        default=SPREAD,
        metavar="S",
        help="relative spread of the design (%(default)s)",
    )
    parser.add_argument(
        "--radii-known",
        action="store_true",
        help="joint radii have the design's ratios to 0.1 %%, making k_s L/EA identifiable",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of the report"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Check the record, fit, write the hand file, and report the file's error at the held-out
    points.
    """
    require()
    base = load_hand(arguments.base) if arguments.base else HPAC
    record = read_sweep(arguments.record, allow_missing=True)
    remarks = judged(record, base)
    second = None
    if arguments.check:
        second = read_sweep(arguments.check, allow_missing=True)
        remarks += [f"{arguments.check.name}: {remark}" for remark in judged(second, base)]
    identified = identify(
        record, base, arguments.spread, arguments.radii_known, True, shown=True, draws=DRAWS
    )
    remarks += doubts(identified, base)
    write_text(arguments.out, hand_to_toml(named(identified, base, arguments.record.name)))
    written = load_hand(arguments.out)
    errors = (
        file_errors(identified, written) if second is None else check_errors(second, written, base)
    )
    if second:
        remarks += contradictions(errors)
    folder = report_folder(arguments.out)
    write_draws(arguments.out, written, identified)
    result = summary(identified, base, errors, remarks, bool(second))
    text = report(identified, base, errors, remarks, arguments.check.name if second else "")
    write_text(folder / "report.md", text)
    write_text(folder / "report.json", json.dumps(result, indent=2) + "\n")
    caption = f"{written.name}, {arguments.record.name}; points, every {HELD_OUT_EVERY}th held out"
    save(fit_figure(identified, base, written), folder / "fit.png", caption)
    print(json.dumps(result) if arguments.json else f"{text}\nwritten: {arguments.out}, {folder}")
    return 0


def named(identified: Identification, base: Hand, record: str) -> Hand:
    """The identified hand with a name and the sources of its numbers."""
    sources = {
        **base.sources,
        **dict.fromkeys(_IDENTIFIED, f"identified from {record}, about {base.name}"),
    }
    for field in ("d1", "spring_stiffness", "tendon_stiffness"):
        sources[field] = f"of {base.name}: angles do not depend on it once the others are fitted"
    if any(fit.samples.stops for fit in identified.fits.values()):
        sources["workspace"] = f"of {base.name}, up to the stops in {record}"
    return replace(identified.hand, name=f"{base.name}, calibrated", sources=sources)


# Accuracy of the written file ---------------------------------------------------------


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
        predicted = np.empty((len(samples.servo), len(JOINTS)))
        servo[:, column] = samples.servo
        for direction in (FLEXION, EXTENSION):
            rows = samples.direction == direction
            predicted[rows] = settled_joints_from_servo(servo[rows], hand, direction)
        rest = samples.joint_pos - predicted[:, [JOINT_INDEX[joint] for joint in samples.joints]]
        table |= {
            joint: (samples, rest[:, i])
            for i, joint in enumerate(samples.joints)
            if joint not in samples.missing
        }
    return {name: table[name] for name in JOINTS if name in table}


def file_errors(identified: Identification, written: Hand) -> dict[str, FileError]:
    """Errors at the held-out points, by joint."""
    return {
        name: error
        for name, (samples, rest) in residuals(identified.samples, written).items()
        if (error := _error(name, samples, rest, held_out_rows(samples)))
    }


def check_errors(second: Sweep, written: Hand, base: Hand) -> dict[str, FileError]:
    """Errors at all the points of an independent sweep, by joint."""
    by_servo = {}
    for servo, name in enumerate(SERVOS):
        root = name.partition("_")[0]
        joints = ("thumb_cmc",) if name == "thumb_cmc" else base.digits[root].joints
        if samples := digit_samples(second, servo, joints, base):
            by_servo[servo] = samples
    return {
        name: error
        for name, (samples, rest) in residuals(by_servo, written).items()
        if (error := _error(name, samples, rest, np.ones(len(rest), dtype=bool)))
    }


def _error(name: str, samples: DigitSamples, rest: Array, rows: np.ndarray) -> FileError | None:
    """The error of one joint at some points; None without any."""
    rows = rows & ~np.isnan(rest)
    if not rows.any():
        return None
    off = np.degrees(np.abs(rest[rows]))
    noise = np.degrees(samples.noise[samples.joints.index(name)])
    return FileError(float(off.mean()), float(off.max()), float(noise), int(rows.sum()))


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


# The report -----------------------------------------------------------------------------


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
    if identified.cmc:
        gain, zero = identified.cmc
        lines += ["## thumb CMC", ""]
        lines += [f"Effective g_CMC {gain.value:.4f}, zero {np.degrees(zero.value):.2f}°.", ""]
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
    lines += [
        f"{joint} rests at {angle:.3f} rad: it, or another joint of the digit, is at a stop. {samples.at_stops} points "
        "are left out; the file's workspace ends there."
        for joint, angle in samples.stops.items()
    ]
    lines += [f"Not measured: {', '.join(samples.missing)}."] if samples.missing else []
    return [*lines, ""]


def fit_figure(identified: Identification, base: Hand, written: Hand) -> Figure:
    """Residuals of the points for the design and for the written file, joint by joint; held-out
    points are rings.
    """
    figure = new_figure(13, 9)
    axes = list(figure.subplots(3, 5).flat)
    designed, table = (residuals(identified.samples, hand) for hand in (base, written))
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
