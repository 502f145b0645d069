"""The base of every command: its parser, argument types, errors in one line, and exit statuses.

It imports nothing but the standard library and the errors of this package, since every command
waits for it."""

import argparse
import errno
import json
import os
import select
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from itertools import takewhile
from types import TracebackType
from typing import Any, NoReturn, TextIO

from hpac_gym.errors import EXTRA_OF, HpacError, install

USAGE_ERROR = 2
INTERRUPTED = 130  # exit status of a shell command ended by Ctrl-C


class Parser(argparse.ArgumentParser):
    """An argument parser with one-line errors without usage text, which tells a mistyped option
    before one that is missing, as the parser of the command that it was given to; it does not hide
    a failure to write its help.
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        words = takewhile("--".__ne__, sys.argv[1:] if args is None else args)
        unknown = [
            word
            for word in words
            if word.startswith("--")
            and " " not in word  # those may be values
            and self._subparsers is None
            and not any(name.startswith(word.split("=")[0]) for name in self._option_string_actions)
        ]
        if not unknown:
            known, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return known, unknown

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


def add_counts(parser: argparse.ArgumentParser, **counts: tuple[int, int | None, str]) -> None:
    """Arguments that are whole numbers: least value, default and help by name."""
    for name, (at_least, default, text) in counts.items():
        option = f"--{name.replace('_', '-')}"
        parser.add_argument(option, type=whole_number(at_least), default=default, help=text)


def add_json(parser: argparse.ArgumentParser) -> None:
    """The argument ``--json`` of a command that tells with `say`."""
    parser.add_argument("--json", action="store_true", help="print one JSON object a line")


def say(as_json: bool, text: str, **facts: Any) -> None:
    """Print a line of text, or its facts as a JSON object in one line."""
    print(json.dumps(facts, ensure_ascii=False) if as_json else text, flush=True)


def plain_warnings() -> None:
    """From now on a warning of this process is one line."""
    warnings.formatwarning = lambda message, *_: f"warning: {message}\n"


def run(command: Callable[[], int | None], unheard: bool = False) -> int:
    """Run a command and return its exit status, 0 for one that returns none; without a standard
    output only if `unheard`.

    An `HpacError`, a missing package of an extra or an unwritable standard output gives one line
    and `USAGE_ERROR`; Ctrl-C gives `INTERRUPTED`. A warning is one line too. Any other exception is
    a bug and keeps its traceback.
    """
    plain_warnings()
    if sys.stderr is None:  # or prints to it go to standard output
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115 - for as long as the program runs
    if sys.stdout is None and not unheard:
        return complain("cannot write to standard output: it is closed")
    if isinstance(sys.stdout, TextIOWrapper):  # whose encoding may lack a sign, such as Windows' →
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        try:
            return command() or 0
        finally:
            if sys.stdout is not None:
                sys.stdout.flush()
    except BrokenPipeError:
        if not _reader_has_left():
            raise
        drop_output()
        return 0
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return INTERRUPTED
    except HpacError as error:
        return complain(str(error))
    except ModuleNotFoundError as error:
        if missing := missing_extra(error):
            return complain(f"this command needs more: {missing}")
        raise
    except OSError as error:
        # Errors of other files have a filename.
        if error.filename or error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.EIO):
            raise
        drop_output()
        return complain(f"cannot write to standard output: {error.strerror}")


@contextmanager
def ended_as_by_ctrl_c() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block as Ctrl-C does, unless they are ignored, as `nohup` has
    it.
    """
    numbers = {signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGTERM)}
    main = threading.current_thread() is threading.main_thread()  # others cannot set handlers
    heard = [number for number in numbers if main and signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, signal.default_int_handler) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def stopped_later() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block: an import of trimesh catches every
    exception, so that a program stopped in it would go on, and MuJoCo's makes an ImportError of it.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came[:1]:
            signal.raise_signal(number)


def _reader_has_left() -> bool:
    """Whether nobody reads standard output any more; assumed where it cannot be asked, as on
    Windows.
    """
    if sys.stdout is None or not hasattr(select, "poll"):
        return sys.stdout is not None
    output = select.poll()
    output.register(sys.stdout, 0)  # its errors alone
    return bool(output.poll(0))


def missing_extra(error: BaseException) -> str | None:
    """How to install the package whose absence an error tells; None for any other error."""
    if not isinstance(error, ModuleNotFoundError):
        return None
    package = (error.name or "").partition(".")[0]
    extra = EXTRA_OF.get(package)
    return extra and f"{install(extra)} (no module {package})"


def explain_missing_extras() -> None:
    """Let ``python -m`` end with one line, not a traceback, where an extra is missing.

    Called by the packages outside of the wheel, whose modules import their libraries when they are
    loaded."""
    before = sys.excepthook

    def hook(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if missing := missing_extra(error):
            complain(f"this command needs more: {missing}")
        else:
            before(kind, error, trace)

    sys.excepthook = hook


def complain(message: str) -> int:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return USAGE_ERROR


def drop_output() -> None:
    """Discard buffered output; otherwise Python would try to write it again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


class Formatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help with every default that there is and that the text does not name itself."""

    def _get_help_string(self, action: argparse.Action) -> str:
        told = action.help or ""
        default = action.default
        named = (
            default is None
            or default is False
            or default in ([], "", float("inf"))
            or "default:" in told
        )
        return told if named else super()._get_help_string(action)


def command_parser(module: str, description: str) -> Parser:
    """Parser of ``python -m module``; its help shows the description and every default."""
    return Parser(
        prog=f"python -m {module}",
        description=description.replace("``", "'"),
        formatter_class=Formatter,
    )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return float("nan")


def seconds(text: str) -> float:
    """Argument type: a number of seconds, 0 or more."""
    value = _number(text)
    if not 0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a number of seconds, 0 or more")
    return value


def minutes(text: str) -> float:
    """Argument type: a positive number of minutes."""
    value = _number(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number of minutes")
    return value
