"""The `hpac` command: what bridge, study, evaluation and the benchmark of speed offer, under one name."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import version

import numpy as np

from hpac_gym import bench
from hpac_gym.bridge import HandLink
from hpac_gym.bridge.commands import add_commands as add_bridge_commands
from hpac_gym.bridge.commands import connector
from hpac_gym.command_line import MissingModule, Parser, needing, run
from hpac_gym.evaluation.commands import add_commands as add_evaluation_commands
from hpac_gym.model import HPAC, SERVOS, Hand, ServoCommand, move_duration

STUDY_COMMANDS = ("sweep", "calibrate", "study", "posture")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns its exit status."""
    parser = Parser(prog="hpac", description="The H-PAC tendon hand, from simulation to the servo.")
    parser.add_argument("--version", action="version", version=f"hpac_gym {version('hpac_gym')}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    add_bridge_commands(commands)
    _add_study_commands(commands)
    add_evaluation_commands(commands)
    bench_parser = commands.add_parser("bench", help="measure the speed of the model and of the environments")
    bench.add_arguments(bench_parser)
    bench_parser.set_defaults(func=bench.run)
    arguments = parser.parse_args(argv)
    return run(lambda: arguments.func(arguments))


def send_posture(port: str, command: ServoCommand, hand: Hand = HPAC) -> None:
    """Arm the hand at a port, move it from rest, wait until it has arrived, and hold it until Ctrl-C.

    Args:
        port: as the bridge's commands take it.
        hand: whose limits the firmware must have been built with.

    Raises:
        BridgeError: The port, the hand or the firmware does not do its part; the hand is then without pulses, or said not
            to have confirmed it.
    """
    with ExitStack() as stack:
        link = stack.enter_context(HandLink(connector(port, hand, stack), hand=hand))
        link.arm()
        rest = np.clip(np.zeros(len(SERVOS)), hand.servo_min, hand.servo_max)
        link.move(ServoCommand(command.servo, max(command.duration, 1.1 * move_duration(rest, command.servo, hand))))
        link.wait()
        print("holding; Ctrl-C lets go", file=sys.stderr)
        try:
            while True:
                link.sleep(1.0)
        except KeyboardInterrupt:
            return


def _add_study_commands(commands: argparse._SubParsersAction) -> None:
    """The study needs SciPy and Matplotlib; without them its commands say so, whatever they are given, and the others work."""
    try:
        with needing("study"):
            from hpac_gym.study.commands import add_commands
    except MissingModule as error:
        for name in STUDY_COMMANDS:
            stub = commands.add_parser(name, help="needs pip install 'hpac_gym[study]'", prefix_chars="\0", add_help=False)
            stub.add_argument("words", nargs="*")
            stub.set_defaults(func=partial(_refuse, error))
        return
    add_commands(commands, send_posture)


def _refuse(error: MissingModule, arguments: argparse.Namespace) -> int:
    raise error


if __name__ == "__main__":
    sys.exit(main())
