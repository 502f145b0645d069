"""Other processes: running one to its end or meanwhile, waiting for them, and dying like one."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import IO

import pytest

ROOT = Path(__file__).resolve().parents[1]


def python(
    *words: str, folder: Path = ROOT, stdout: IO | int = subprocess.PIPE, **variables: str
) -> subprocess.CompletedProcess[str]:
    """A Python process that has this checkout on its path, after its end."""
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)} | variables,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        timeout=600,
        check=False,
    )


@contextmanager
def started(
    *words: str, session: bool = False, **variables: str
) -> Iterator[subprocess.Popen[str]]:
    """A Python process that runs during the block, at whose end it is killed; in a session of its
    own, if so, as on a terminal of its own.
    """
    with subprocess.Popen(
        [sys.executable, *words],
        env=os.environ | {"PYTHONPATH": str(ROOT)} | variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=session,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def wait_for(condition, seconds: float = 120) -> None:
    """Wait until something holds; fail when it has not after some time [s]."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def children_of(process: subprocess.Popen[str], count: int) -> list[int]:
    """The numbers of a process's children, as soon as it has so many."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    wait_for(lambda: len(children.read_text().split()) >= count)
    return [int(child) for child in children.read_text().split()]


def wait_for_the_end(processes: list[int], seconds: float = 120) -> None:
    """Wait until processes have ended; fail when one has not after some time [s]."""
    wait_for(lambda: not any(map(_runs, processes)), seconds)


def _runs(process: int) -> bool:
    """Whether there is such a process; one that only waits to be buried is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@contextmanager
def killed_at_the_second(module: ModuleType, name: str) -> Iterator[None]:
    """A block that ends with the second call of a function, as if the process were killed there."""
    function = getattr(module, name)
    called = []

    def dying(*given):
        if called:
            raise KeyboardInterrupt
        called.append(function(*given))
        return called[0]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, name, dying)
        with pytest.raises(KeyboardInterrupt):
            yield
