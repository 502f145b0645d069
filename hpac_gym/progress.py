"""A progress bar on standard error, for whatever takes over two seconds."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator
from time import monotonic
from typing import TypeVar

Item = TypeVar("Item")

_WIDTH = 30
_PATIENCE = 2.0  # s, what ends sooner shows nothing


def progress(items: Collection[Item], label: str, shown: bool = True) -> Iterator[Item]:
    """The items, with a bar that appears after two seconds where standard error is a terminal.

    Args:
        items: what to go through.
        label: what stands before the bar.
        shown: False for none at all.
    """
    start, drawn, shown = monotonic(), False, shown and sys.stderr.isatty()
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
        text = f"\r{label} {'█' * _WIDTH} {len(items)}/{len(items)}, {monotonic() - start:.0f} s      "
        print(text, file=sys.stderr, flush=True)
