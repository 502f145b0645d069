"""``hpac study``: what the compensation is worth on other hands than its own, and what the paper leaves to future work."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Collection
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from hpac import whole_number
from hpac_gym.errors import HpacError
from hpac_gym.output import write_text
from hpac_gym.study import commands, hidden, populations, rivals, seeds, tracking, trials
from hpac_gym.study.populations import Workshop
from hpac_gym.study.reference import REFERENCE_FILE, load_reference
from hpac_gym.study.results import Part, save

TRIAL_PROTOCOL = {"points": 15, "seconds_per_point": 3.0}
"""Slow: a finger that stops from a faster move overshoots into the band where friction holds it, and the hysteresis is gone."""
QUICK_PROTOCOL = {"points": 9, "seconds_per_point": 1.0}
COMMANDED = "all of these, geometry 1 %"
"""The workshop whose hands are calibrated and commanded."""


class StudyError(HpacError, ValueError):
    """The command line names a part that is not there."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"which of {', '.join(PARTS)} (default: all)")
    parser.add_argument("--hands", type=whole_number(2), metavar="N", help="hands of each population (400; costly parts: fewer)")
    parser.add_argument("--seeds", type=whole_number(2), default=20, metavar="N", help="of the reference sweep (%(default)s)")
    parser.add_argument("--trials", type=whole_number(3), default=5, metavar="N", help="trials, tracking runs (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all of them (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="few and coarse: a test of the command, not a result")
    parser.add_argument("--reference", type=Path, default=REFERENCE_FILE, metavar="TOML", help="the simulated hand and camera")
    parser.add_argument("--out", type=Path, default=Path("runs/study"), metavar="DIR", help="where results go (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the report")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the parts one after the other; each writes its table, its figures and its numbers when it is done."""
    unknown = [name for name in arguments.parts if name not in PARTS]
    if unknown:
        raise StudyError(f"{', '.join(unknown)}: hpac study knows the parts {', '.join(PARTS)}")
    results = {}
    for name in arguments.parts or PARTS:
        part = PARTS[name](arguments)
        for stem, figure in part.figures.items():
            save(figure, arguments.out / f"{stem}.png", part.caption)
        write_text(arguments.out / f"{name}.md", part.text)
        results[name] = part.data
        write_text(arguments.out / f"{name}.json", json.dumps(part.data, indent=2, default=asdict) + "\n")
        if not arguments.json:
            print(part.text)
    print(json.dumps(results, default=asdict) if arguments.json else f"written to {arguments.out}")
    return 0


def _hands(arguments: argparse.Namespace, usual: int) -> int:
    return arguments.hands or (4 if arguments.quick else usual)


# The parts: what the options mean for each ------------------------------------------------


def _rivals(stem: str, options: argparse.Namespace) -> Part:
    return rivals.rivals(stem, _hands(options, 8), options.seed, (3, 8) if options.quick else rivals.SAMPLES)


def _commands(name: str, workshop: Workshop, maps: Collection[str], options: argparse.Namespace) -> Part:
    return commands.commands(name, workshop, _hands(options, 100), options.seed, maps)


def _trials(options: argparse.Namespace) -> Part:
    reference = load_reference(options.reference)
    protocol = QUICK_PROTOCOL if options.quick else TRIAL_PROTOCOL
    slow = replace(reference, rig=reference.rig.with_protocol(**protocol))
    return trials.trials(slow, options.trials, options.seed)


PARTS: dict[str, Callable[[argparse.Namespace], Part]] = {
    "populations": lambda options: populations.populations(_hands(options, 400), options.seed),
    "causes": lambda options: populations.causes(),
    "seeds": lambda options: seeds.seeds(
        options.reference, 2 if options.quick else options.seeds, {0.75: 1.0} if options.quick else seeds.SPEEDS
    ),
    "rivals": partial(_rivals, "rivals"),
    "rivals-at-home": partial(_rivals, "rivals-at-home"),
    "calibration": lambda options: hidden.calibration(
        _hands(options, 100), options.seed, 0 if options.quick else max(_hands(options, 100) // 20, 2)
    ),
    "commands": partial(_commands, COMMANDED, populations.WORKSHOPS[COMMANDED], commands.MAPS),
    "commands-other-laws": partial(_commands, *rivals.RACES["rivals"], commands.BEFORE_AND_AFTER),
    "trials": _trials,
    "tracking": lambda options: tracking.tracking(
        load_reference(options.reference), options.trials, options.seed, (0.5,) if options.quick else tracking.RATES_HZ
    ),
}
"""Parts by the name that the command line takes."""
