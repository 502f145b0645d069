"""What every command shares: complaints of one line, and exit statuses."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any, NoReturn, TextIO

from hpac_gym.errors import HpacError

USAGE_ERROR = 2
INTERRUPTED = 130  # what a shell reports of a command ended by Ctrl-C


class MissingModule(HpacError, ModuleNotFoundError):
    """A command needs a package that is not installed."""


class UnwritableOutput(HpacError, OSError):
    """Standard output takes no more, and its reader has not just left."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaint is one line, without the usage, and whose help tells when it cannot be written."""

    def _print_message(self, message: str, file: TextIO | None = None) -> None:
        if file is not sys.stdout:
            super()._print_message(message, file)
        elif status := run(lambda: print(message, end="") or 0):
            self.exit(status)

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


class _Output:
    """Standard output, whose faults are told from those of any other file."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        if self._stream is None:
            raise UnwritableOutput("cannot write to standard output: it is closed")
        with _faults_told():
            return self._stream.write(text)

    def flush(self) -> None:
        if self._stream is not None:
            with _faults_told():
                self._stream.flush()


@contextmanager
def _faults_told() -> Iterator[None]:
    try:
        yield
    except (BrokenPipeError, UnwritableOutput):
        raise
    except OSError as error:
        raise UnwritableOutput(f"cannot write to standard output: {error.strerror}") from None


def _drop_output() -> None:
    """Leave what is still buffered nowhere, or Python would try once more at its exit."""
    if sys.stdout is not None:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def run(command: Callable[[], int]) -> int:
    """Run a command and return its exit status; an error that was raised on purpose becomes one line and `USAGE_ERROR`."""
    try:
        with redirect_stdout(_Output(sys.stdout)):
            status = command()
            sys.stdout.flush()
        return status
    except BrokenPipeError:  # whoever read the output has seen enough
        _drop_output()
        return 0
    except HpacError as error:
        if isinstance(error, UnwritableOutput):
            _drop_output()
        print(f"error: {' '.join(str(error).split())}", file=sys.stderr)
        return USAGE_ERROR
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
