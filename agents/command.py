"""What every command of this package shares: one-line errors and exit statuses."""

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn

from hpac_gym.errors import HpacError

INTERRUPTED = 130  # what a shell reports of a command ended by Ctrl-C


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line, without the usage."""

    def __init__(self, description: str | None) -> None:
        super().__init__(description=description, formatter_class=argparse.ArgumentDefaultsHelpFormatter)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"error: {message} (see --help)\n")


def whole_number(at_least: int) -> Callable[[str], int]:
    """A type of argument: a whole number that is ``at_least`` so large."""

    def parse(text: str) -> int:
        if not text.strip().lstrip("+-").isdecimal() or int(text) < at_least:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least {at_least}")
        return int(text)

    return parse


def minutes(text: str) -> float:
    """A type of argument: a positive number of minutes."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number of minutes")
    return value


def run(main: Callable[[], int]) -> NoReturn:
    """Run a command and leave with its status; an error that was raised on purpose becomes one line and status 2."""
    try:
        sys.exit(main())
    except HpacError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
