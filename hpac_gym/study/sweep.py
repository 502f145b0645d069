"""``hpac sweep``: the paper's mapping-accuracy experiment, on the simulated reference hand or on a record of a real one."""

from __future__ import annotations

import argparse
import csv
import io
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hpac_gym.model import HPAC, JOINTS, Hand, load_hand
from hpac_gym.output import write_text
from hpac_gym.study import figures
from hpac_gym.study.accuracy import Accuracy, accuracy, residuals, workspace
from hpac_gym.study.judging import judged
from hpac_gym.study.processing import CUTOFF_HZ, points, processed
from hpac_gym.study.record import Sweep, read_sweep, write_sweep
from hpac_gym.study.reference import REFERENCE_FILE, Reference, load_reference

WORKSPACE_STREAM, EVALUATION_STREAM = 0, 1
"""Streams of the camera's noise: two separate sweeps."""


WORKSPACE_POINTS = 21


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    folder = Path("runs/sweep")
    parser.add_argument("--record", type=Path, metavar="CSV", help="evaluate this record, sweep nothing")
    parser.add_argument("--hand", type=Path, metavar="TOML", help="the model under test (default: the nominal hand)")
    parser.add_argument("--reference", type=Path, default=REFERENCE_FILE, metavar="TOML", help="the simulated hand and camera")
    parser.add_argument("--out", type=Path, default=folder, metavar="DIR", help="where results go (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the table")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Sweep or read, evaluate, write figures and tables."""
    hand = load_hand(arguments.hand) if arguments.hand else HPAC
    out, shown = arguments.out, not arguments.json
    result: dict[str, object] = {"hand": hand.name}
    if arguments.record:
        record, cutoff_hz = read_sweep(arguments.record), CUTOFF_HZ
        result |= {"record": str(arguments.record), "remarks": judged(record, hand)}
        caption, text = f"{arguments.record.name} against {hand.name}", ""
    else:
        reference = load_reference(arguments.reference)
        record, cutoff_hz = simulate(reference, EVALUATION_STREAM, "evaluation sweep" if shown else ""), reference.cutoff_hz
        write_sweep(out / "sweep.csv", record)
        first = simulate(reference, WORKSPACE_STREAM, "workspace sweep" if shown else "", points=WORKSPACE_POINTS)
        write_sweep(out / "workspace.csv", first)
        table = workspace(points(processed(first, cutoff_hz)))
        result |= {"seed": reference.seed, "workspace_rad": {name: list(bounds) for name, bounds in table.items()}}
        caption = f"reference hand, seed {reference.seed}, simulated, against {hand.name}"
        text = workspace_table(table, hand)
        write_text(out / "workspace.md", text)
    found = residuals(points(processed(record, cutoff_hz)), hand)
    errors = accuracy(found)
    result |= asdict(errors)
    text = "\n".join([accuracy_table(errors), *(f"\nRemark: {remark}." for remark in result.get("remarks", ())), "", text])
    figures.save(figures.residual_figure(found), out / "residuals.png", caption)
    figures.save(figures.mae_figure(errors), out / "mae.png", caption)
    write_text(out / "accuracy.csv", accuracy_csv(errors))
    write_text(out / "accuracy.md", accuracy_table(errors) + "\n")
    write_text(out / "sweep.json", json.dumps(result, indent=2) + "\n")
    print(json.dumps(result) if arguments.json else f"{text}\nwritten to {out}")
    return 0


def simulate(reference: Reference, stream: int, label: str = "", **protocol: object) -> Sweep:
    """One sweep of the reference hand, with its own stream of camera noise."""
    return reference.rig.with_protocol(**protocol).sweep(np.random.default_rng([reference.seed, stream]), label=label)


def accuracy_table(errors: Accuracy) -> str:
    """The errors as a Markdown table."""
    lines = ["| joint | MAE uncompensated [°] | compensated | largest uncompensated [°] | compensated |", "|---|--:|--:|--:|--:|"]
    for name in errors.mae_deg["compensated"]:
        cells = [table[kind][name] for table in (errors.mae_deg, errors.max_residual_deg) for kind in table]
        lines.append(f"| {figures.label(name)} | {' | '.join(f'{cell:.2f}' for cell in cells)} |")
    return "\n".join(lines)


def accuracy_csv(errors: Accuracy) -> str:
    """The errors for a spreadsheet, one joint a row."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    kinds = list(errors.mae_deg)
    writer.writerow(["joint", *(f"mae_{kind}_deg" for kind in kinds), *(f"max_residual_{kind}_deg" for kind in kinds)])
    for name in errors.mae_deg[kinds[0]]:
        values = [table[kind][name] for table in (errors.mae_deg, errors.max_residual_deg) for kind in kinds]
        writer.writerow([name, *(f"{value:.4f}" for value in values)])
    return text.getvalue()


def workspace_table(table: dict[str, tuple[float, float]], hand: Hand) -> str:
    """Measured workspace in the form of Table I, beside the paper's, with what the rigid map makes of Table I's driven joint."""
    lines = ["| finger joint | label | measured [q_min, q_max] (rad) | Table I (rad) | short of Table I [°] | rigid map (rad) |"]
    lines.append("|---|---|---|---|--:|--:|")
    rigid = hand.synergy_max.take(hand.servo_of_joint) * hand.rigid_ratio
    for name, (low, high) in table.items():
        lower, upper = hand.workspace[name]
        measured = f"[{low + 0.0:.2f}, {high:.2f}]".replace("-0.00", "0.00")
        lines.append(
            f"| {figures.label(name)} | q{JOINTS.index(name) + 1} | {measured} | [{lower:.2f}, {upper:.2f}] | "
            f"{np.degrees(upper - high):.1f} | {rigid[JOINTS.index(name)]:.3f} |"
        )
    return "\n".join(lines) + "\n"
