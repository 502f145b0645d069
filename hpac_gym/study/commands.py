"""The study's commands for ``hpac``: each parser's ``func`` takes the namespace and returns an exit status."""

from __future__ import annotations

import argparse

from hpac_gym.study import sweep


def add_commands(subparsers: argparse._SubParsersAction) -> None:
    """Add every command of the study."""
    for name, module in (("sweep", sweep),):
        summary = module.__doc__.splitlines()[0].partition(": ")[2]
        parser = subparsers.add_parser(name, help=summary, description=summary)
        module.add_arguments(parser)
        parser.set_defaults(func=module.run)
