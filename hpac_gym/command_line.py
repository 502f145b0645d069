"""What every command shares: complaints of one line, and exit statuses."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NoReturn

from hpac_gym.errors import HpacError

USAGE_ERROR = 2
INTERRUPTED = 130  # what a shell reports of a command ended by Ctrl-C


class MissingModule(HpacError, ModuleNotFoundError):
    """A command needs a package that is not installed."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line, without the usage."""

    def error(self, message: str) -> NoReturn:
        self.exit(USAGE_ERROR, f"error: {message} (see {self.prog} --help)\n")


def whole_number(at_least: int) -> Callable[[str], int]:
    """A type of argument: a whole number that is ``at_least`` so large."""

    def parse(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            value = at_least - 1
        if value < at_least:
            raise argparse.ArgumentTypeError(f"'{text}' is not a whole number of at least {at_least}")
        return value

    return parse


@contextmanager
def needing(extra: str) -> Iterator[None]:
    """Imports of packages that only an extra of this project brings.

    Raises:
        MissingModule: One of them is not installed; the message names the extra.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("hpac_gym"):
            raise
        raise MissingModule(f"this command needs more: pip install 'hpac_gym[{extra}]' (no module {error.name})") from None


def run(command: Callable[[], int]) -> int:
    """Run a command and return its exit status; an error that was raised on purpose becomes one line and `USAGE_ERROR`."""
    try:
        status = command()
        sys.stdout.flush()
        return status
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except HpacError as error:
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
