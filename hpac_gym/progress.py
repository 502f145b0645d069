"""Progress on standard error of what takes longer than a second or two."""

import math
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Thread
from time import monotonic
from typing import TypeVar

from tqdm import tqdm

Item = TypeVar("Item")

_PATIENCE = 2.0  # s, shorter loops show no bar


def progress(items: Iterable[Item], label: str, shown: bool = True) -> Iterable[Item]:
    """Iterate over items, with a progress bar that appears after two seconds if standard error is a
    terminal.

    Args:
        items: the items.
        label: text in front of the bar.
        shown: False for no bar.
    """
    shown = shown and sys.stderr.isatty()
    return tqdm(items, label, delay=_PATIENCE, disable=not shown, dynamic_ncols=True)


class Late:
    """A line on standard error, printed by the first call that comes a second after it was made or
    later. For loops that wait while a hand listens, and may run in a signal handler.
    """

    def __init__(self, text: str) -> None:
        self._text = text
        self._due = monotonic() + 1.0

    def __call__(self) -> None:
        if monotonic() >= self._due:
            self._due = math.inf
            # It may be closed, or the handler may have interrupted a print.
            with suppress(OSError, RuntimeError, ValueError):
                print(self._text, file=sys.stderr, flush=True)


@contextmanager
def waiting(label: str) -> Iterator[None]:
    """Show a label and the elapsed time during the block, from two seconds on, if standard error is a
    terminal. For one long call of a library, which must release Python's lock.
    """
    done = Event()

    def show() -> None:
        if sys.stderr.isatty() and not done.wait(_PATIENCE):
            with tqdm(desc=label, bar_format="{desc}: {elapsed}", leave=False) as bar:
                while not done.wait(0.5):
                    bar.refresh()

    thread = Thread(target=show, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
