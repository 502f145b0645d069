"""Settings of all tests: the same examples every time, one thread a process, and what is skipped
without PyBullet or a browser.
"""

import os
import signal
import socket
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

PYBULLET = find_spec("pybullet") is not None
CHROMIUM = Path("/usr/bin/chromium")
BROWSER = CHROMIUM.exists() and find_spec("playwright") is not None
LONGEST = "test_processor.py"
"""Comes first, so that no process of pytest-xdist waits for it at the end."""

os.environ.setdefault("OMP_NUM_THREADS", "1")
# A shell's background job ignores Ctrl-C, and what it starts would, too.
signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("default", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("default")


@pytest.fixture
def udp() -> Iterator[socket.socket]:
    """A UDP socket that is bound to a free port of this computer."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        yield made


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest tests; skip those that need what is missing here: PyBullet, by their
    marker or a parameter, or a browser.
    """
    items.sort(key=lambda item: item.path.name != LONGEST)
    for item in items:
        if not PYBULLET and (item.get_closest_marker("pybullet") or _is_of_pybullet(item)):
            item.add_marker(pytest.mark.skip(reason="needs PyBullet, which is not installed"))
        if not BROWSER and item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.skip(reason=f"needs {CHROMIUM} and the extra browser"))


def _is_of_pybullet(item: pytest.Item) -> bool:
    values = item.callspec.params.values() if hasattr(item, "callspec") else ()
    parts = [part for value in values for part in (value if isinstance(value, tuple) else (value,))]
    return any(isinstance(part, str) and part == "pybullet" for part in parts)
