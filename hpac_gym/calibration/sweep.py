"""``hpac sweep``: the figures of the paper's mapping-accuracy experiment, of a record of a hand."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hpac_gym.calibration.accuracy import (
    Accuracy,
    accuracy,
    mae_figure,
    residual_figure,
    residuals,
)
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.processing import points, processed
from hpac_gym.calibration.record import Sweep, read_sweep
from hpac_gym.figures import label, require, save
from hpac_gym.model import HPAC, Hand, load_hand
from hpac_gym.output import markdown, write_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac sweep`."""
    parser.add_argument("--record", type=Path, required=True, metavar="CSV", help="the record")
    add_common_arguments(parser)
    parser.set_defaults(run=run)


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that the simulated experiment has too."""
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


def run(arguments: argparse.Namespace) -> int:
    """Read a record, evaluate it, write figures and tables."""
    require()
    hand = load_hand(arguments.hand) if arguments.hand else HPAC
    record = read_sweep(arguments.record)
    evaluate(
        record,
        hand,
        arguments,
        caption=f"{arguments.record.name} against {hand.name}",
        result={"hand": hand.name, "record": str(arguments.record)},
        remarks=judged(record, hand),
    )
    return 0


def evaluate(
    record: Sweep,
    hand: Hand,
    arguments: argparse.Namespace,
    *,
    caption: str,
    result: dict[str, object],
    remarks: list[str],
    text: str = "",
) -> None:
    """Write and print the accuracy of a model on a record.

    Args:
        record: the record.
        hand: the model under test.
        arguments: `out` and `json` of the command line.
        caption: caption of the figures.
        result: first entries of the JSON object.
        remarks: remarks on the record.
        text: more text of the report.
    """
    out = arguments.out
    cleaned = processed(record)
    left_out = int(np.isnan(cleaned.joint_pos).sum() - np.isnan(record.joint_pos).sum())
    if left_out:
        remarks = [*remarks, f"{left_out} samples lie far from their neighbours and are left out"]
    found = residuals(points(cleaned), hand)
    errors = accuracy(found)
    result = result | {"remarks": remarks, **asdict(errors)}
    text = "\n".join(
        [accuracy_table(errors), *(f"\nRemark: {remark}." for remark in remarks), "", text]
    )
    save(residual_figure(found), out / "residuals.png", caption)
    save(mae_figure(errors), out / "mae.png", caption)
    write_text(out / "accuracy.md", accuracy_table(errors) + "\n")
    write_text(out / "sweep.json", json.dumps(result, indent=2) + "\n")
    print(json.dumps(result) if arguments.json else f"{text}\nwritten to {out}")


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
