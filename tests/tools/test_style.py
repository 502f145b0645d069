import pytest

from tools.style import parallel_assignments


@pytest.mark.parametrize("source", ["a, b = 1, 2", "x.a, y[0] = f(), 2", "(a, b) = (c, d)"])
def test_unrelated_things_in_one_assignment_are_found(source):
    assert list(parallel_assignments(source)) == [1]


@pytest.mark.parametrize(
    "source", ["a, b = b, a", "a, b = f()", "a = 1, 2", "a = b = 3", "x, y = y, x + y"]
)
def test_swaps_pairs_and_tuples_are_not(source):
    assert not list(parallel_assignments(source))
