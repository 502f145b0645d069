"""``hpac calibrate``: a hand file from a sweep of the hand, with what the record can and cannot tell."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, Hand, elastic_joints_from_servo, hand_to_toml, load_hand
from hpac_gym.output import write_text
from hpac_gym.study import figures
from hpac_gym.study.combinations import TYPICAL_FRICTION, values
from hpac_gym.study.identification import SPREAD, Identification, identify, predicted_joints
from hpac_gym.study.processing import without_drift
from hpac_gym.study.record import PHASES, Sweep, joints_of_servo, read_sweep

OUT = Path("runs/calibrate/hand.toml")
_IDENTIFIED = ("d2", "alpha_deg", "servo_radius", "joint_radius", "path_length", "drive_stiffness", "cmc_gain")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("record", type=Path, metavar="sweep.csv", help="the record; a joint without measurement may be left out")
    parser.add_argument("--out", type=Path, default=OUT, metavar="TOML", help="the hand file to write (%(default)s)")
    parser.add_argument("--base", type=Path, metavar="TOML", help="the hand's design (default: the nominal hand)")
    parser.add_argument("--spread", type=float, default=SPREAD, metavar="S", help="relative spread about the design")
    parser.add_argument(
        "--radii-known", action="store_true", help="joint radii have the design's ratios to 0.1 %%, so that k_s L/EA can be told"
    )
    parser.add_argument("--report", type=Path, metavar="DIR", help="where report and figures go (default: beside the hand file)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the report")


def run(arguments: argparse.Namespace) -> int:
    """Fit, write the hand file, the report and its figures."""
    base = load_hand(arguments.base) if arguments.base else HPAC
    record = read_sweep(arguments.record, allow_missing=True)
    found = identify(record, base, arguments.spread, arguments.radii_known, shown=not arguments.json)
    hand = named(found, base, arguments.record.name)
    folder = arguments.report or arguments.out.with_name(f"{arguments.out.stem}-report")
    text = report(found, base, record)
    write_text(folder / "report.md", text)
    write_text(folder / "report.json", json.dumps(summary(found, base, record), indent=2) + "\n")
    figures.save(fit_figure(found, base, record), folder / "fit.png")
    figures.save(estimate_figure(found, base), folder / "estimates.png")
    write_text(arguments.out, hand_to_toml(hand))
    print(json.dumps(summary(found, base, record)) if arguments.json else f"{text}\nwritten: {arguments.out}, {folder}")
    return 0


def named(found: Identification, base: Hand, record: str) -> Hand:
    """The identified hand with a name and the sources of its numbers."""
    sources = {**base.sources, **dict.fromkeys(_IDENTIFIED, f"identified from {record}, about {base.name}")}
    for field in ("d1", "spring_stiffness", "tendon_stiffness"):
        sources[field] = f"of {base.name}: angles do not depend on it once the others are fitted"
    return replace(found.hand, name=f"{base.name}, calibrated", sources=sources)


def residual(found: Identification, record: Sweep) -> dict[str, np.ndarray]:
    """Samples less the identified hand's prediction, by joint, in flexion at the sampling points [rad]."""
    return {name: measured - predicted_joints(servo, found)[:, JOINT_INDEX[name]] for name, servo, measured in _samples(record)}


def rms_deg(found: Identification, record: Sweep) -> dict[str, float]:
    """Root mean square of `residual` by joint [°]."""
    return {name: float(np.degrees(np.sqrt(np.mean(rest**2)))) for name, rest in residual(found, record).items()}


def _samples(record: Sweep):
    corrected = without_drift(record)
    held = (record.phase == PHASES.index("flexion")) & (record.point >= 0)
    for servo in np.unique(record.swept[held]):
        for joint in joints_of_servo(int(servo)):
            rows = held & (record.swept == servo) & ~np.isnan(record.joint_pos[:, joint])
            if rows.any():
                yield JOINTS[joint], record.servo[rows], corrected.joint_pos[rows, joint]


def summary(found: Identification, base: Hand, record: Sweep) -> dict[str, object]:
    """Everything that the report says, for a program."""
    return {
        "base": base.name,
        "digits": {
            name: {
                "estimates": {item.name: asdict(item) for item in fit.estimates},
                "joint_friction_nm": fit.friction.joint,
                "noise_deg": float(np.degrees(fit.noise)),
                "samples": fit.samples,
                "outliers": fit.outliers,
                "not_told_apart": [list(group) for group in fit.confounded],
                "missing": list(fit.missing),
            }
            for name, fit in found.fits.items()
        },
        "cmc_gain": asdict(found.cmc_gain) if found.cmc_gain else None,
        "kept": found.kept,
        "rms_residual_deg": rms_deg(found, record),
    }


def report(found: Identification, base: Hand, record: Sweep) -> str:
    """The report as Markdown."""
    lines = [f"# Calibration about {base.name}", ""]
    rms = rms_deg(found, record)
    for name, fit in found.fits.items():
        design = values(base.digits[name], TYPICAL_FRICTION)
        lines += [f"## {name}", "", "| combination | formula | design | found | 95 % interval | told by the data |"]
        lines.append("|---|---|--:|--:|---|--:|")
        for item, nominal in zip(fit.estimates, design, strict=True):
            cells = (item.name, item.formula, f"{nominal:.4g}", f"{item.value:.4g}", f"{item.low:.4g} … {item.high:.4g}")
            lines.append(f"| {' | '.join(cells)} | {item.told:.0%} |")
        errors = ", ".join(f"{joint} {rms[joint]:.2f}°" for joint in base.digits[name].joints if joint in rms)
        noise = f"noise of a sample {np.degrees(fit.noise):.2f}°; {fit.samples} samples, {fit.outliers} outliers"
        lines += ["", f"RMS residual: {errors}; {noise}."]
        lines += [f"Not measured: {', '.join(fit.missing)}."] if fit.missing else []
        for first, *others in fit.confounded:
            apart = f"; it cannot be told apart from {', '.join(others)}" if others else ""
            lines.append(f"The record hardly tells {first}{apart}.")
        lines.append("")
    if found.cmc_gain:
        gain = found.cmc_gain
        lines += ["## thumb CMC", "", f"g_CMC = {gain.value:.4f}, 95 % interval {gain.low:.4f} … {gain.high:.4f}", ""]
    lines += [f"{name} keeps the design's numbers: {why}." for name, why in found.kept.items()]
    return "\n".join(lines)


def fit_figure(found: Identification, base: Hand, record: Sweep) -> Figure:
    """Residuals of the samples against the design and against the identified hand, joint by joint."""
    figure = Figure(figsize=(13, 9), layout="constrained")
    axes = figure.subplots(3, 5, sharey="row").flat
    fitted = residual(found, record)
    for axis, (name, servo, measured) in zip(axes, _samples(record), strict=False):
        angle = np.degrees(servo[:, base.servo_of_joint[JOINT_INDEX[name]]])
        design = measured - elastic_joints_from_servo(servo, base)[:, JOINT_INDEX[name]]
        axis.plot(angle, np.degrees(design), ".", color=figures.RED, markersize=2, label="design")
        axis.plot(angle, np.degrees(fitted[name]), ".", color=figures.GREEN, markersize=2, label="identified")
        axis.axhline(0.0, color=figures.GREY, linewidth=0.8)
        axis.set_title(figures.label(name), fontsize=9)
    figure.supxlabel("servo angle [°]")
    figure.supylabel("sample − prediction [°]")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=2, frameon=False, markerscale=5)
    return figure


def estimate_figure(found: Identification, base: Hand) -> Figure:
    """Every estimate over its design value, with its 95 % interval; pale where the data says little."""
    figure = Figure(figsize=(3 * len(found.fits), 4), layout="constrained")
    axes = np.ravel(figure.subplots(1, len(found.fits), sharex=True, squeeze=False))
    for axis, (name, fit) in zip(axes, found.fits.items(), strict=True):
        design = values(base.digits[name], TYPICAL_FRICTION)
        for row, (item, nominal) in enumerate(zip(fit.estimates, design, strict=True)):
            interval = np.array([item.low, item.high]) / nominal
            alpha = 0.25 + 0.75 * item.told
            axis.plot(interval, [row, row], color=figures.BLUE, linewidth=3, alpha=alpha)
            axis.plot(item.value / nominal, row, "o", color=figures.BLUE, alpha=alpha)
        axis.set_yticks(range(len(fit.estimates)), [item.name for item in fit.estimates], fontsize=8)
        axis.axvline(1.0, color=figures.GREY, linewidth=0.8)
        axis.set_xscale("log")
        axis.invert_yaxis()
        axis.set_title(name)
    figure.supxlabel("identified / design")
    return figure
