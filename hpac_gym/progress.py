"""A progress bar on standard error for loops that take longer than two seconds."""

from __future__ import annotations

import sys
from collections.abc import Iterable
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
