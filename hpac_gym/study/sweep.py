"""``hpac sweep``: the paper's mapping-accuracy experiment, on the simulated reference hand or on a
record of a real one.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hpac_gym.model import HPAC, JOINT_INDEX, Hand, load_hand
from hpac_gym.output import markdown, write_text
from hpac_gym.study.accuracy import (
    Accuracy,
    accuracy,
    mae_figure,
    residual_figure,
    residuals,
    workspace,
)
from hpac_gym.study.judging import judged
from hpac_gym.study.processing import points, processed
from hpac_gym.study.record import Sweep, read_sweep, write_sweep
from hpac_gym.study.reference import Reference
from hpac_gym.study.results import label, save

WORKSPACE_STREAM = 0
EVALUATION_STREAM = 1
"""Random streams of the camera's noise in the two sweeps."""
WORKSPACE_POINTS = 21


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument(
        "--record",
        type=Path,
        metavar="CSV",
        help="evaluate this record instead of simulating a sweep",
    )
    parser.add_argument(
        "--hand", type=Path, metavar="TOML", help="the model under test (default: the nominal hand)"
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("runs/sweep"),
        metavar="DIR",
        help="folder of the results (%(default)s)",
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object instead of the table"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Simulate or read a sweep, evaluate it, write figures and tables."""
    hand = load_hand(arguments.hand) if arguments.hand else HPAC
    out = arguments.out
    result: dict[str, object] = {"hand": hand.name}
    remarks: list[str] = []
    if arguments.record:
        record = read_sweep(arguments.record)
        result["record"] = str(arguments.record)
        remarks = judged(record, hand)
        caption = f"{arguments.record.name} against {hand.name}"
        text = ""
    else:
        reference = Reference.of()
        record = simulate(reference, EVALUATION_STREAM, "evaluation sweep")
        write_sweep(out / "sweep.csv", record)
        first = simulate(reference, WORKSPACE_STREAM, "workspace sweep", points=WORKSPACE_POINTS)
        write_sweep(out / "workspace.csv", first)
        table = workspace(points(processed(first)))
        result |= {
            "seed": reference.seed,
            "workspace_rad": {name: list(bounds) for name, bounds in table.items()},
        }
        caption = f"reference hand, seed {reference.seed}, simulated, against {hand.name}"
        text = workspace_table(table, hand)
        write_text(out / "workspace.md", text)
    cleaned = processed(record)
    left_out = int(np.isnan(cleaned.joint_pos).sum() - np.isnan(record.joint_pos).sum())
    if left_out:
        remarks.append(f"{left_out} samples lie far from their neighbours and are left out")
    found = residuals(points(cleaned), hand)
    errors = accuracy(found)
    result |= {"remarks": remarks, **asdict(errors)}
    text = "\n".join(
        [accuracy_table(errors), *(f"\nRemark: {remark}." for remark in remarks), "", text]
    )
    save(residual_figure(found), out / "residuals.png", caption)
    save(mae_figure(errors), out / "mae.png", caption)
    write_text(out / "accuracy.md", accuracy_table(errors) + "\n")
    write_text(out / "sweep.json", json.dumps(result, indent=2) + "\n")
    print(json.dumps(result) if arguments.json else f"{text}\nwritten to {out}")
    return 0


def simulate(reference: Reference, stream: int, label: str = "", **protocol: object) -> Sweep:
    """Simulate one sweep of the reference hand, with its own stream of camera noise."""
    return reference.rig.with_protocol(**protocol).sweep(
        np.random.default_rng([reference.seed, stream]), label=label
    )


def accuracy_table(errors: Accuracy) -> str:
    """The errors as a Markdown table."""
    head = (
        "joint",
        "MAE uncompensated [°]",
        "compensated",
        "largest uncompensated [°]",
        "compensated",
    )
    columns = [table[kind] for table in (errors.mae_deg, errors.max_residual_deg) for kind in table]
    return markdown(
        head, [(label(name), *(f"{column[name]:.2f}" for column in columns)) for name in columns[0]]
    )


def workspace_table(table: dict[str, tuple[float, float]], hand: Hand) -> str:
    """Measured workspace in the form of Table I, compared with the paper's and with the rigid map
    of its driven joints.
    """
    head = (
        "finger joint",
        "label",
        "measured [q_min, q_max] (rad)",
        "Table I (rad)",
        "short of Table I [°]",
        "rigid map (rad)",
    )
    rigid = hand.synergy_max.take(hand.servo_of_joint) * hand.rigid_ratio
    rows = []
    for name, (low, high) in table.items():
        joint = JOINT_INDEX[name]
        (lower, upper) = hand.workspace[name]
        bounds = f"[{low:z.2f}, {high:z.2f}]", f"[{lower:.2f}, {upper:.2f}]"
        rows.append(
            (
                label(name),
                f"q{joint + 1}",
                *bounds,
                f"{np.degrees(upper - high):.1f}",
                f"{rigid[joint]:.3f}",
            )
        )
    return markdown(head, rows) + "\n"
