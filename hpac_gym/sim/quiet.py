"""PyBullet prints from C straight to file descriptors 1 and 2, where a command's own lines go. This keeps it out."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quiet_output() -> Iterator[None]:
    """Send what C code writes to standard output and error nowhere, for as long as the block runs; either may be closed."""
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    while (sink := os.open(os.devnull, os.O_WRONLY)) <= 2:
        pass  # it was closed; kept open like this, no file takes its number
    saved = [(descriptor, os.dup(descriptor)) for descriptor in (1, 2)]
    try:
        for descriptor, _ in saved:
            os.dup2(sink, descriptor)
        yield
    finally:
        for descriptor, copy in saved:
            os.dup2(copy, descriptor)
            os.close(copy)
        os.close(sink)
