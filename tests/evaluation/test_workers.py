"""Shared work: its order, its errors, and what becomes of a worker."""

import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor

import pytest

from hpac_gym.errors import WorkspaceError
from hpac_gym.evaluation.workers import WorkerError, shared

JOBS = [(number, 2) for number in range(7)]


def product(first: int, second: int) -> int:
    return first * second


def refuse(first: int, second: int) -> int:
    raise WorkspaceError(f"{first} rad is above {second} rad")


def die(first: int, second: int) -> int:
    os._exit(9)


@pytest.mark.parametrize("count", [1, 2])
def test_results_come_in_the_order_of_the_jobs(count):
    assert list(shared(product, JOBS, count)) == [2 * number for number in range(7)]


@pytest.mark.parametrize("count", [1, 2])
def test_an_error_in_a_worker_is_raised_here(count):
    with pytest.raises(WorkspaceError, match="0 rad is above 2 rad"):
        list(shared(refuse, JOBS, count))


def test_a_worker_that_is_ended_from_outside_is_told():
    with pytest.raises(WorkerError, match="ended from outside"):
        list(shared(die, JOBS, 2))


def nap(number: int) -> int:
    time.sleep(0.01)
    return number


def test_ctrl_c_leaves_no_traceback_of_the_pool_s_thread(monkeypatch):
    """A busy machine, on which a moment passes between the interrupt and the end of the pool."""
    said, shutdown = [], ProcessPoolExecutor.shutdown

    def late(self, *arguments, **named):
        time.sleep(0.5)
        shutdown(self, *arguments, **named)

    monkeypatch.setattr(ProcessPoolExecutor, "shutdown", late)
    monkeypatch.setattr(threading, "excepthook", said.append)
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    results = shared(nap, [(number,) for number in range(1000)], 2)
    next(results)
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    try:
        with pytest.raises(KeyboardInterrupt):
            list(results)
    finally:
        signal.signal(signal.SIGINT, handler)
    assert said == []
