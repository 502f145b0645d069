"""``hpac calibrate``: a hand file from a sweep of the hand, with a report of what the record can
identify.
"""

import argparse
import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpac_gym.calibration.identification import SPREAD, Identification, doubts, identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.posterior import DRAWS, draws_text, report_folder
from hpac_gym.calibration.record import RecordError, read_sweep
from hpac_gym.calibration.report import (
    check_errors,
    contradictions,
    file_errors,
    fit_figure,
    report,
    summary,
)
from hpac_gym.calibration.samples import HELD_OUT_EVERY
from hpac_gym.figures import require, save
from hpac_gym.model import Hand, hand_to_toml, load_hand
from hpac_gym.model.files import hand_from_toml
from hpac_gym.output import OutputError, replacing, writable_file, writable_folder

OUT = Path("runs/calibrate/hand.toml")
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
    """Check the record, fit, report the hand file's error at the held-out points, and write it."""
    require()
    for path in (arguments.record, arguments.check, arguments.base):
        if path and path.resolve() == arguments.out.resolve():
            raise OutputError(f"--out {arguments.out} would replace a file that is read")
    base = load_hand(arguments.base)
    record = read_sweep(arguments.record)
    remarks = judged(record, base, f"sweep {arguments.record}")
    second = None
    if arguments.check:
        second = read_sweep(arguments.check)
        if np.array_equal(second.joint_pos, record.joint_pos, equal_nan=True):
            raise RecordError(
                f"--check {arguments.check} is the same sweep; it must be a second one"
            )
        remarks += [
            f"{arguments.check.name}: {remark}"
            for remark in judged(second, base, f"sweep {arguments.check}")
        ]
        unseen = [name for name in record.measured() if name not in second.measured()]
        if unseen:
            raise RecordError(
                f"--check {arguments.check} does not measure {', '.join(unseen)}: its bound is one of all joints of the file"
            )
    writable_file(arguments.out)
    folder = report_folder(arguments.out)
    if folder.exists():
        writable_folder(folder)
    identified = identify(
        record, base, arguments.spread, arguments.radii_known, True, shown=True, draws=DRAWS
    )
    remarks += doubts(identified, base)
    text = hand_to_toml(named(identified, base, arguments.record.name))
    written = hand_from_toml(text, str(arguments.out))
    errors = own = file_errors(identified, written)
    if second:
        errors = check_errors(second, written, base)
        remarks += contradictions({name: errors[name] for name in own if name in errors})
    result = summary(identified, base, errors, remarks, bool(second))
    told = report(identified, base, errors, remarks, arguments.check.name if second else "")
    texts = {
        arguments.out: text,
        folder / "draws.json": draws_text(written, identified),
        folder / "report.md": told,
        folder / "report.json": json.dumps(result, indent=2) + "\n",
    }
    caption = f"{written.name}, {arguments.record.name}; points, every {HELD_OUT_EVERY}th held out"
    with ExitStack() as together:  # all of them, or none: on a full disk, too
        for path, content in texts.items():
            together.enter_context(replacing(path)).write_text(content, encoding="utf-8")
        save(fit_figure(identified, base, written), folder / "fit.png", caption)
    print(json.dumps(result) if arguments.json else f"{told}\nwritten: {arguments.out}, {folder}")
    return 0


def named(identified: Identification, base: Hand, record: str) -> Hand:
    """The identified hand with a name and the sources of its numbers."""
    fitted = [name for name in _IDENTIFIED if name != "cmc_gain" or identified.cmc]
    kept = ", ".join(name for name in base.digits if name in identified.kept)
    source = f"identified from {record}, about {base.name}" + f"; {kept} as there" * bool(kept)
    sources = {**base.sources, **dict.fromkeys(fitted, source)}
    for field in ("d1", "spring_stiffness", "tendon_stiffness"):
        sources[field] = f"of {base.name}: angles do not depend on it once the others are fitted"
    if any(samples.stops for samples in identified.samples.values()):
        sources["workspace"] = f"of {base.name}, up to the stops in {record}"
    return replace(identified.hand, name=f"{base.name}, calibrated", sources=sources)
