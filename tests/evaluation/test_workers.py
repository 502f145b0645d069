"""Shared work: its order, its errors, and what becomes of a worker."""

import os

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
