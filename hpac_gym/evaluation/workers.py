"""Processes that share the work, end with the command that started them, and leave Ctrl-C to it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any, TypeVar

from hpac_gym.errors import HpacError

Result = TypeVar("Result")


class WorkerError(HpacError, RuntimeError):
    """A worker process was ended from outside."""


@contextmanager
def worker_pool(count: int, prepare: Callable[..., None] | None = None, arguments: tuple = ()) -> Iterator[ProcessPoolExecutor]:
    """A pool of ``count`` processes, each of which first calls ``prepare(*arguments)``.

    Work that is not begun when the block ends is dropped; an error in the block ends the processes at once.

    Raises:
        WorkerError: A process was ended from outside, as by a system that runs out of memory.
    """
    others = set(multiprocessing.active_children())
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _start, (prepare, arguments))
    try:
        yield pool
    except BaseException as error:  # Ctrl-C too: nobody waits for what is under way
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        if isinstance(error, BrokenProcessPool):
            raise WorkerError(f"one of {count} worker processes was ended from outside: is there memory for so many?") from None
        raise
    finally:
        pool.shutdown(cancel_futures=True)


def shared(function: Callable[..., Result], jobs: Sequence[tuple], count: int) -> Iterator[Result]:
    """The results of ``function(*job)`` in the order of the jobs, as they are done by ``count`` processes; 1 is this one.

    Raises:
        WorkerError: As `worker_pool`.
    """
    if count == 1:
        yield from (function(*job) for job in jobs)
        return
    with worker_pool(count) as pool:
        yield from pool.map(function, *zip(*jobs, strict=True))


def _start(prepare: Callable[..., None] | None, arguments: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    if prepare:
        prepare(*arguments)


def _end_with_parent() -> None:
    """A killed command closes no pool: without this its workers would wait for work for ever."""
    multiprocessing.parent_process().join()
    os._exit(1)
