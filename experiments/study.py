"""``python -m experiments.study``: accuracy of the compensation on hands with tolerances, and the
paper's future work."""

import argparse
import json
import sys
from collections.abc import Callable, Collection
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

from experiments import commands, hidden, labels, populations, rivals, sweep, tracking, trials
from experiments.populations import Workshop
from experiments.results import Part
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.figures import save
from hpac_gym.output import writable_folder, write_text

TRIAL_PROTOCOL = {"points": 15, "seconds_per_point": 3.0}
"""Slow, because a finger that stops from a faster move overshoots within its friction band, which
hides the hysteresis.
"""
QUICK_PROTOCOL = {"points": 9, "seconds_per_point": 1.0}
COMMANDED = "all of these, geometry 1 %"
"""Tolerances of the hands that are calibrated and commanded."""


def main(argv: list[str] | None = None) -> None:
    """Run the parts in sequence; each writes its table, figures and numbers when it is complete."""
    parser = command_parser("experiments.study", __doc__)
    parser.add_argument(
        "parts",
        nargs="*",
        choices=("all", *PARTS),
        default="all",
        metavar="PART",
        help=f"parts to run: {', '.join(PARTS)} (default: all)",
    )
    add_counts(
        parser,
        hands=(2, None, "hands per population (400; costly parts: fewer)"),
        seeds=(2, 20, "reference seeds"),
        trials=(3, 5, "trials and tracking runs"),
        seed=(0, 0, "seed of all parts"),
    )
    parser.add_argument(
        "--quick", action="store_true", help="few and coarse runs, to test the command"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("runs/study"), metavar="DIR", help="folder of the results"
    )
    arguments = parser.parse_args(argv)
    writable_folder(arguments.out)
    for name in PARTS if "all" in arguments.parts else arguments.parts:
        part = PARTS[name](arguments)
        for stem, figure in part.figures.items():
            save(figure, arguments.out / f"{stem}.png", part.caption)
        write_text(arguments.out / f"{name}.md", part.text)
        write_text(
            arguments.out / f"{name}.json", json.dumps(part.data, indent=2, default=asdict) + "\n"
        )
        print(part.text)
    print(f"written to {arguments.out}")


def _hands(arguments: argparse.Namespace, usual: int) -> int:
    return arguments.hands or (4 if arguments.quick else usual)


# The parts: interpretation of the options -------------------------------------------------


def _commands(
    name: str, workshop: Workshop, maps: Collection[str], options: argparse.Namespace
) -> Part:
    return commands.commands(name, workshop, _hands(options, 100), options.seed, maps)


def _trials(options: argparse.Namespace) -> Part:
    hand = sweep.Reference.of()
    slow = replace(
        hand, rig=hand.rig.with_protocol(**(QUICK_PROTOCOL if options.quick else TRIAL_PROTOCOL))
    )
    return trials.trials(slow, options.trials, options.seed)


PARTS: dict[str, Callable[[argparse.Namespace], Part]] = {
    "populations": lambda options: populations.populations(_hands(options, 400), options.seed),
    "causes": lambda options: populations.causes(),
    "seeds": lambda options: sweep.seeds(
        2 if options.quick else options.seeds, {0.75: 1.0} if options.quick else sweep.SPEEDS
    ),
    "rivals": lambda options: rivals.rivals(
        _hands(options, 8), options.seed, (3, 8) if options.quick else rivals.SAMPLES
    ),
    "calibration": lambda options: hidden.calibration(
        _hands(options, 100),
        options.seed,
        0 if options.quick else max(_hands(options, 100) // 20, 2),
    ),
    "labels": lambda options: labels.labels(
        _hands(options, 100),
        options.seed,
        0 if options.quick else max(_hands(options, 100) // 50, 2),
    ),
    "commands": partial(_commands, COMMANDED, populations.WORKSHOPS[COMMANDED], commands.MAPS),
    "commands-other-laws": partial(
        _commands,
        rivals.TITLE,
        rivals.OTHER_METAL,
        commands.BEFORE_AND_AFTER,
    ),
    "trials": _trials,
    "tracking": lambda options: tracking.tracking(
        sweep.Reference.of(),
        options.trials,
        options.seed,
        (0.5,) if options.quick else tracking.RATES_HZ,
    ),
}
"""Parts by their names on the command line."""


if __name__ == "__main__":
    sys.exit(run(main))
