import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpac_gym.evaluation.statistics import paired_difference, wilson_interval


@pytest.mark.parametrize(
    ("successes", "trials", "low", "high"),
    [
        # Newcombe 1998 (Statistics in Medicine 17), table I, method 3.
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_wilson_interval_equals_newcombes_published_values(successes, trials, low, high):
    assert wilson_interval(successes, trials) == pytest.approx((low, high), abs=5e-5)


@given(st.integers(1, 5_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_wilson_interval_holds_the_rate_and_mirrors(counts):
    successes, trials = counts
    low, high = wilson_interval(successes, trials)
    assert 0 <= low <= successes / trials <= high <= 1
    assert wilson_interval(trials - successes, trials) == pytest.approx((1 - high, 1 - low))


@given(st.integers(1, 500), st.integers(0, 500))
def test_wilson_bounds_solve_the_score_equation(trials, successes):
    successes = min(successes, trials)
    for bound in wilson_interval(successes, trials):
        gap = (successes / trials - bound) ** 2 - 1.959963984540054**2 * bound * (1 - bound) / trials
        assert gap == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (-1, 5), (6, 5)])
def test_impossible_counts_are_refused(successes, trials):
    with pytest.raises(ValueError, match="successes"):
        wilson_interval(successes, trials)


def test_paired_difference_is_symmetric_and_tightens_with_agreement():
    estimate, low, high = paired_difference(40, 10, 200)
    assert estimate == pytest.approx(0.15)
    assert low < estimate < high
    assert paired_difference(10, 40, 200) == pytest.approx((-estimate, -high, -low))
    calm = paired_difference(30, 0, 200)
    assert calm[2] - calm[1] < high - low


def test_paired_difference_equals_agresti_and_mins_formula():
    # b = 12, c = 5 of n = 100: (12.5 − 5.5)/102 ± 1.96·√(18 − 7²/102)/102.
    _, low, high = paired_difference(12, 5, 100)
    assert (low, high) == pytest.approx((-0.011803, 0.149058), abs=1e-5)
