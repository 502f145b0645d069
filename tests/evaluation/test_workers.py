"""Shared work: its order, its errors, and what becomes of a worker."""

import itertools
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor

import pytest

from hpac_gym import progress
from hpac_gym.errors import WorkspaceError
from hpac_gym.evaluation.workers import AHEAD, WorkerError, shared

JOBS = [(number, 2) for number in range(7)]
DONE = [2 * number for number in range(7)]


def product(first: int, second: int) -> int:
    return first * second


def refuse(first: int, second: int) -> int:
    raise WorkspaceError(f"{first} rad is above {second} rad")


def die(first: int, second: int) -> int:
    os._exit(9)


@pytest.mark.parametrize("processes", [1, 2])
def test_processes_work_in_order_and_raise_errors(processes):
    assert list(shared(product, JOBS, processes)) == DONE
    with pytest.raises(WorkspaceError, match="0 rad is above 2 rad"):
        list(shared(refuse, JOBS, processes))


def test_a_label_shows_how_many_jobs_are_done_on_a_terminal(capsys, monkeypatch):
    monkeypatch.setattr(progress, "_PATIENCE", 0.0)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    assert list(shared(product, JOBS, 1)) == DONE
    assert capsys.readouterr().err == ""
    assert list(shared(product, JOBS, 1, "products")) == DONE
    seen = capsys.readouterr().err
    assert "products" in seen
    assert "7/7" in seen


def count(number: int) -> int:
    return len(list(progress.progress(range(number), "numbers")))


def test_a_job_with_a_bar_of_its_own_leaves_no_semaphore_behind():
    program = (
        "from hpac_gym.evaluation.workers import shared\n"
        "from tests.evaluation.test_workers import count\n"
        "print(list(shared(count, [(2,), (3,)], 2)))"
    )
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (told.stdout, told.stderr) == ("[2, 3]\n", "")


def test_two_processes_tell_when_one_is_ended_from_outside():
    with pytest.raises(WorkerError, match="ended from outside"):
        list(shared(die, JOBS, 2))


def test_workers_take_jobs_as_they_need_them():
    taken = []
    results = shared(
        product, ((number, 2) for number in itertools.count() if taken.append(number) is None), 2
    )
    assert list(itertools.islice(results, 40)) == [2 * number for number in range(40)]
    assert len(taken) <= 40 + 2 * AHEAD
    results.close()


def nap(number: int) -> int:
    time.sleep(0.01)
    return number


def test_ctrl_c_leaves_no_traceback_of_the_pool_s_thread(monkeypatch):
    """A busy machine, on which a moment passes between the interrupt and the end of the pool."""
    said = []
    shutdown = ProcessPoolExecutor.shutdown

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


def sleep(number: int) -> bytes:
    """More than a pipe holds, and then a job that nobody waits for."""
    time.sleep(60 * number)
    return bytes(10_000_000)


@pytest.mark.parametrize("pause", [0.0, 0.2])
def test_running_jobs_are_ended_also_in_the_middle_of_a_result(pause):
    results = shared(sleep, [(number,) for number in (0, 0, *[0, 1] * 8)], 2)
    next(results)
    time.sleep(pause)
    workers = multiprocessing.active_children()
    began = time.monotonic()
    results.close()
    assert time.monotonic() - began < 5
    assert len(workers) == 2
    assert not any(worker.is_alive() for worker in workers)
