"""A progress bar on standard error for loops that take longer than two seconds."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from time import monotonic
from typing import TypeVar

Item = TypeVar("Item")

_WIDTH = 30
_PATIENCE = 2.0  # s, shorter loops show no bar


def progress(items: Collection[Item], label: str, shown: bool = True) -> Iterator[Item]:
    """Iterate over items, with a progress bar that appears after two seconds if standard error is a
    terminal.

    Args:
        items: the items.
        label: text in front of the bar.
        shown: False for no bar.
    """
    start = monotonic()
    drawn = False
    shown = shown and sys.stderr.isatty()
    for done, item in enumerate(items):
        elapsed = monotonic() - start
        if shown and elapsed > _PATIENCE:
            drawn = True
            share = done / len(items)
            bar = "█" * round(_WIDTH * share)
            remaining = elapsed / done * (len(items) - done) if done else 0.0
            text = f"\r{label} {bar:░<{_WIDTH}} {done}/{len(items)}, {remaining:.0f} s left  "
            print(text, end="", file=sys.stderr, flush=True)
        yield item
    if drawn:
        text = (
            f"\r{label} {'█' * _WIDTH} {len(items)}/{len(items)}, {monotonic() - start:.0f} s      "
        )
        print(text, file=sys.stderr, flush=True)
