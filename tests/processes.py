"""Waiting for other processes, and dying like one."""

import time
from collections.abc import Callable


def wait_for(condition, seconds: float = 120) -> None:
    """Wait until something holds; fail when it has not after some time [s]."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def once_alive(function: Callable) -> Callable:
    """The function, which raises KeyboardInterrupt when it is called again, as if the process were
    killed there.
    """
    called = []

    def dying(*given):
        if called:
            raise KeyboardInterrupt
        called.append(function(*given))

    return dying
