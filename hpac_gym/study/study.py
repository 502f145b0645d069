"""``hpac study``: what the compensation is worth on other hands than its own, and what the paper leaves to future work."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from hpac_gym.errors import HpacError
from hpac_gym.output import write_text
from hpac_gym.study import commands, hidden, populations, rivals, seeds, tracking, trials
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
    parser.add_argument("--hands", type=_count(2), metavar="N", help="hands of each population (400; of the costly parts fewer)")
    parser.add_argument("--seeds", type=_count(2), default=20, metavar="N", help="seeds of the reference sweep (%(default)s)")
    parser.add_argument("--trials", type=_count(3), default=5, metavar="N", help="trials, tracking runs (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="of all of them (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="few and coarse: a test of the command, not a result")
    parser.add_argument("--reference", type=Path, default=REFERENCE_FILE, metavar="TOML", help="the simulated hand and camera")
    parser.add_argument("--out", type=Path, default=Path("runs/study"), metavar="DIR", help="where results go (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of the report")
    parser.set_defaults(run=run)


def _count(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not text.isdigit() or int(text) < least:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least {least}")
        return int(text)

    return parse


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


def _populations(options: argparse.Namespace) -> Part:
    return populations.populations(_hands(options, 400), options.seed, not options.json)


def _seeds(options: argparse.Namespace) -> Part:
    speeds = {0.75: 1.0} if options.quick else seeds.SPEEDS
    return seeds.seeds(options.reference, 2 if options.quick else options.seeds, speeds, not options.json)


def _rivals(stem: str, options: argparse.Namespace) -> Part:
    samples = (3, 8) if options.quick else rivals.SAMPLES
    return rivals.rivals(stem, _hands(options, 8), options.seed, samples, not options.json)


def _calibration(options: argparse.Namespace) -> Part:
    count = _hands(options, 100)
    return hidden.calibration(count, options.seed, 0 if options.quick else max(count // 20, 2), not options.json)


def _commands(options: argparse.Namespace) -> Part:
    workshop = populations.WORKSHOPS[COMMANDED]
    return commands.commands(COMMANDED, workshop, _hands(options, 100), options.seed, shown=not options.json)


def _commands_other_laws(options: argparse.Namespace) -> Part:
    name, workshop = rivals.RACES["rivals"]
    return commands.commands(name, workshop, _hands(options, 100), options.seed, commands.BEFORE_AND_AFTER, not options.json)


def _trials(options: argparse.Namespace) -> Part:
    reference = load_reference(options.reference)
    protocol = QUICK_PROTOCOL if options.quick else TRIAL_PROTOCOL
    slow = replace(reference, rig=reference.rig.with_protocol(**protocol))
    return trials.trials(slow, options.trials, options.seed, not options.json)


def _tracking(options: argparse.Namespace) -> Part:
    rates = (0.5,) if options.quick else tracking.RATES_HZ
    return tracking.tracking(load_reference(options.reference), options.trials, options.seed, rates, not options.json)


PARTS: dict[str, Callable[[argparse.Namespace], Part]] = {
    "populations": _populations,
    "causes": lambda options: populations.causes(),
    "seeds": _seeds,
    "rivals": partial(_rivals, "rivals"),
    "rivals-at-home": partial(_rivals, "rivals-at-home"),
    "calibration": _calibration,
    "commands": _commands,
    "commands-other-laws": _commands_other_laws,
    "trials": _trials,
    "tracking": _tracking,
}
"""Parts by the name that the command line takes."""
