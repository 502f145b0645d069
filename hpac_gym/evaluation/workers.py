"""Worker processes, which end with the command that started them and leave Ctrl-C to it."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import TypeVar

from tqdm import tqdm

from hpac_gym.command import plain_warnings
from hpac_gym.errors import HpacError
from hpac_gym.progress import progress

AHEAD = 8
"""Jobs that a pool takes for each of its processes before it waits for a result: there may be more
than fit into memory.
"""
Result = TypeVar("Result")


class WorkerError(HpacError, RuntimeError):
    """A worker process was ended from outside."""


def shared(
    function: Callable[..., Result], jobs: Iterable[tuple], count: int, label: str = ""
) -> Iterator[Result]:
    """Results of ``function(*job)`` in the order of the jobs, computed by ``count`` processes; 1 is
    the calling process. With a label they come with a progress bar, and the jobs must be a list.

    At the end, also by an error or Ctrl-C, or when the iterator is closed, the processes are killed
    at once.

    Raises:
        WorkerError: A process was ended from outside, for example by a system that is out of
            memory.
    """
    if label:
        done = shared(function, jobs, count)
        yield from (result for _, result in zip(progress(jobs, label), done, strict=True))
        return
    if count == 1:
        yield from (function(*job) for job in jobs)
        return
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _start)
    # Not pool.map: it cancels its futures in this thread, and the pool's own thread prints a
    # traceback for a cancelled one.
    futures = deque()
    try:
        for job in jobs:
            with _interrupts_held():
                futures.append(pool.submit(function, *job))
            if len(futures) == AHEAD * count:
                yield futures.popleft().result()
        while futures:
            yield futures.popleft().result()
    except BrokenProcessPool:
        raise WorkerError(
            f"one of {count} worker processes was ended from outside: is there memory for so many?"
        ) from None
    finally:
        # Python's pool has no public way. A killed process may leave half a result in the pipe, for
        # whose end the pool's thread would wait for ever if this process could still write it.
        for process in list(pool._processes.values()):
            process.kill()
        pool._result_queue._writer.close()
        pool.shutdown(cancel_futures=True)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Delay Ctrl-C until the block ends. Processes started in the block never receive it, not even
    during their start.

    Windows has no signal masks: there a worker may print a traceback on Ctrl-C.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _start() -> None:
    plain_warnings()
    tqdm.set_lock(threading.RLock())  # its own holds a semaphore, which a killed worker leaks
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this worker when its parent ends: a killed command does not close its pool, and its
    workers would wait for ever.
    """
    multiprocessing.parent_process().join()
    os._exit(1)
