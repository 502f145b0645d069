"""The `hpac` command: a table of subcommands, each imported when it is used.

This module is outside the package because `import hpac_gym` registers the environments and thus
loads Gymnasium and NumPy, which the list of commands does not need."""

from __future__ import annotations

import argparse
import errno
import os
import sys
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import NoReturn, TextIO

USAGE_ERROR = 2
INTERRUPTED = 130  # exit status of a shell command ended by Ctrl-C


@dataclass(frozen=True, slots=True)
class Command:
    """One row of the table of commands."""

    name: str
    help: str
    """Help text of one line."""
    target: str
    """`module:function`; the function adds the command's arguments to a parser and sets its default
    `run`, which takes the parsed arguments and returns the exit status."""
    extra: str | None = None
    """Optional dependencies of this project that the command needs."""


COMMANDS = (
    Command(
        "agree",
        "run the same episodes on several engines and bodies",
        "hpac_gym.evaluation.agree:add_arguments",
    ),
    Command(
        "bench",
        "measure the speed of the environments on both engines",
        "hpac_gym.bench:add_arguments",
    ),
    Command(
        "calibrate",
        "fit the hand parameters to a record of a real hand",
        "hpac_gym.study.calibrate:add_arguments",
        "study",
    ),
    Command(
        "clear",
        "leave a fault, or disarm: no motion, no pulses",
        "hpac_gym.bridge.commands:add_clear",
    ),
    Command(
        "conform",
        "test a device against every rule of docs/wire.md",
        "hpac_gym.bridge.commands:add_conform",
    ),
    Command(
        "doctor",
        "find hands, report faults and the first remedy; moves nothing",
        "hpac_gym.bridge.commands:add_doctor",
    ),
    Command("estop", "stop all pulses now and latch a fault", "hpac_gym.bridge.commands:add_estop"),
    Command(
        "export",
        "write a policy file as ONNX with a card",
        "hpac_gym.policies.export:add_arguments",
        "onnx",
    ),
    Command(
        "grasps",
        "evaluate a policy on the sixteen named grasps",
        "hpac_gym.evaluation.grasps:add_arguments",
        "grasps",
    ),
    Command(
        "physics",
        "check every engine and body against the paper and statics",
        "hpac_gym.physics.conformance:add_arguments",
    ),
    Command(
        "posture",
        "show, draw or send a gesture or grasp shape of the paper",
        "hpac:add_posture",
        "study",
    ),
    Command(
        "record",
        "record episodes of a policy for Minari or LeRobot",
        "hpac_gym.evaluation.dataset:add_arguments",
        "data",
    ),
    Command(
        "safety",
        "measure the safety claims, each with a negative control",
        "hpac_gym.bridge.commands:add_safety",
    ),
    Command(
        "study",
        "accuracy of the compensation on hands with tolerances",
        "hpac_gym.study.study:add_arguments",
        "study",
    ),
    Command(
        "sweep",
        "the paper's experiment, or the same figures of a record",
        "hpac_gym.study.sweep:add_arguments",
        "study",
    ),
    Command(
        "wiggle", "move one servo at a time next to its name", "hpac_gym.bridge.commands:add_wiggle"
    ),
)


class Parser(argparse.ArgumentParser):
    """An argument parser with one-line errors without usage text; it does not hide a failure to
    write its help.
    """

    def _print_message(self, message: str, file: TextIO | None = None) -> None:
        (file or sys.stderr).write(message)

    def error(self, message: str) -> NoReturn:
        self.exit(USAGE_ERROR, f"error: {message} (see {self.prog} --help)\n")


def whole_number(at_least: int) -> Callable[[str], int]:
    """Argument type: a whole number of at least `at_least`."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = at_least - 1
        if not at_least <= value < 2**63:
            below = "" if value < at_least else " and below 2⁶³"
            raise argparse.ArgumentTypeError(
                f"'{text}' is not a whole number of at least {at_least}{below}"
            )
        return value

    return parse


def run(command: Callable[[], int]) -> int:
    """Run a command and return its exit status.

    An `HpacError` or an unwritable standard output gives one line and `USAGE_ERROR`; Ctrl-C gives
    `INTERRUPTED`. A warning is one line too. Any other exception is a bug and keeps its traceback.
    """
    warnings.formatwarning = lambda message, *_: f"warning: {message}\n"
    if sys.stdout is None:
        return _complain("cannot write to standard output: it is closed")
    try:
        try:
            return command()
        finally:
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of the output has closed it
        _drop_output()
        return 0
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        from hpac_gym.errors import HpacError

        if isinstance(error, HpacError):
            return _complain(str(error))
        # Errors of other files have a filename.
        if (
            isinstance(error, OSError)
            and error.filename is None
            and error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EIO)
        ):
            _drop_output()
            return _complain(f"cannot write to standard output: {error.strerror}")
        raise


def _complain(message: str) -> int:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return USAGE_ERROR


def _drop_output() -> None:
    """Discard buffered output; otherwise Python would try to write it again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    return run(lambda: _main(sys.argv[1:] if argv is None else argv))


def _main(argv: Sequence[str]) -> int:
    parser = Parser(prog="hpac", description="The H-PAC tendon hand, from simulation to the servo.")
    parser.add_argument("--version", action=_Version)
    subparsers = parser.add_subparsers(metavar="COMMAND", required=True)
    parsers = {
        row.name: subparsers.add_parser(row.name, help=row.help, description=row.help)
        for row in COMMANDS
    }
    name = next((word for word in argv if not word.startswith("-")), None)
    row = next((row for row in COMMANDS if row.name == name), None)
    try:
        if row is not None:
            module, _, function = row.target.partition(":")
            getattr(import_module(module), function)(parsers[row.name])
        arguments = parser.parse_args(argv)
        return arguments.run(arguments)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if row is None or row.extra is None or package in ("", "hpac_gym"):
            raise
        return _complain(
            f"this command needs more: pip install 'hpac_gym[{row.extra}]' (no module {package})"
        )


class _Version(argparse.Action):
    """Reads the version only when it is requested."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        print(f"hpac_gym {version('hpac_gym')}")
        parser.exit()


def add_posture(parser: argparse.ArgumentParser) -> None:
    """Add `hpac posture`, which joins the study's command and the bridge; these are independent of
    each other.
    """
    from hpac_gym.bridge.commands import send_and_hold
    from hpac_gym.study import posture

    posture.add_arguments(parser, send_and_hold)


if __name__ == "__main__":
    sys.exit(main())
