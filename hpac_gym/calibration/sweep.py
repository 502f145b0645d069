"""``hpac sweep``: a record of a hand that is swept, or one that is there, and the figures of the paper's
mapping-accuracy experiment of it.
"""

import argparse
import json
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np

from hpac_gym.bridge.commands import PORT_HELP
from hpac_gym.calibration.accuracy import (
    EVALUATED,
    Accuracy,
    accuracy,
    mae_figure,
    residual_figure,
    residuals,
)
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.processing import points, processed
from hpac_gym.calibration.record import RecordError, Sweep, read_sweep
from hpac_gym.command import whole_number
from hpac_gym.figures import label, require, save
from hpac_gym.model import SERVOS, Hand, load_hand
from hpac_gym.output import markdown, write_text


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac sweep`."""
    of = parser.add_mutually_exclusive_group(required=True)
    of.add_argument(
        "--port",
        help=f"sweep this hand into DIR/sweep.csv, and keep one that had the servo as sweep-1.csv: {PORT_HELP}",
    )
    of.add_argument("--record", type=Path, metavar="CSV", help="take this record; nothing moves")
    by = parser.add_mutually_exclusive_group()
    by.add_argument(
        "--camera",
        metavar="N[,FILE]",
        help="watch the tags of `hpac tags` with this camera, whose FILE `hpac tags --calibrate` writes",
    )
    by.add_argument(
        "--angles",
        type=Path,
        metavar="CSV",
        help="joint angles that another program writes meanwhile: time_s since 1970, joint_…_rad",
    )
    parser.add_argument(
        "--servo",
        choices=SERVOS,
        action="append",
        help="sweep only this servo; may be repeated; the others that DIR/sweep.csv has stay",
    )
    parser.add_argument(
        "--points",
        type=whole_number(3),
        metavar="K",
        help="sampling points of a servo (31); with 9 a servo takes half a minute",
    )
    parser.add_argument("--trial", type=whole_number(0), help="number of the repetition (0)")
    add_common_arguments(parser)
    parser.set_defaults(run=run)


def add_common_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that the simulated experiment has too."""
    parser.add_argument(
        "--model", type=Path, metavar="FILE", help="hand file under test (default: nominal)"
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
    """Sweep a hand or read a record, evaluate it, write figures and tables."""
    require()
    hand = load_hand(arguments.model)
    path = arguments.record
    if path is None:
        from hpac_gym.calibration import driven  # takes a second to load

        path = arguments.out / "sweep.csv"
        if arguments.camera is None and arguments.angles is None:
            raise RecordError("--port needs what measures the joints: --camera or --angles")
        record = driven.record(
            arguments.port,
            path,
            camera=arguments.camera,
            angles=arguments.angles,
            servos=arguments.servo or SERVOS,
            trial=arguments.trial or 0,
            points=arguments.points,
            hand=hand,
            ask=_ask if sys.stdin is None or sys.stdin.isatty() else None,
        )
    elif (
        arguments.servo
        or arguments.camera
        or arguments.angles
        or arguments.points
        or arguments.trial is not None
    ):
        raise RecordError(
            "--camera, --angles, --servo, --points and --trial are of --port, not of --record"
        )
    else:
        record = read_sweep(path)
    evaluate(
        record,
        hand,
        arguments,
        caption=f"{path.name} against {hand.name}",
        result={"hand": hand.name, "record": str(path)},
        remarks=judged(record, hand, f"sweep {path}"),
    )
    return 0


def _ask(what: str) -> None:
    """Tell a person what to do, on standard error beside the results, and wait for Enter.

    Raises:
        RecordError: Standard input is closed, or has ended.
    """
    print(what, file=sys.stderr, flush=True)
    if sys.stdin is None or not sys.stdin.readline():
        raise RecordError("standard input has ended: nobody answers")


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
    by_joint = residuals(points(cleaned), hand)
    if not by_joint.keys() & set(EVALUATED):
        raise RecordError(
            f"the record measures none of the joints that the figures show: {', '.join(EVALUATED)}"
        )
    errors = accuracy(by_joint)
    result = result | {"remarks": remarks, **asdict(errors)}
    text = "\n".join(
        [accuracy_table(errors), *(f"\nRemark: {remark}." for remark in remarks), "", text]
    )
    save(residual_figure(by_joint), out / "residuals.png", caption)
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
