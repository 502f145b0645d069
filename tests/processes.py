"""Waiting for other processes."""

import time


def wait_for(condition, seconds: float = 120) -> None:
    """Wait until something holds; fail when it has not after some time [s]."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)
