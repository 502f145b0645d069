"""The study's commands for ``hpac``: each parser's ``func`` takes the namespace and returns an exit status."""

from __future__ import annotations

import argparse

from hpac_gym.study import beyond, calibrate, gallery, sweep


def add_commands(subparsers: argparse._SubParsersAction, send_posture: gallery.Send | None = None) -> None:
    """Add every command of the study.

    Args:
        subparsers: of the command line.
        send_posture: sends a `ServoCommand` to the hand on a serial port; ``hpac posture --port`` needs it. It is given
            from above, because the study does not know the bridge.
    """
    _add(subparsers, "sweep", sweep)
    _add(subparsers, "calibrate", calibrate)
    _add(subparsers, "study", beyond)
    _add(subparsers, "posture", gallery, send=send_posture)


def _add(subparsers: argparse._SubParsersAction, name: str, module, **options: object) -> None:
    summary = module.__doc__.splitlines()[0].partition(": ")[2].rstrip(".")
    parser = subparsers.add_parser(name, help=summary, description=summary)
    module.add_arguments(parser, **options)
    parser.set_defaults(func=module.run)
