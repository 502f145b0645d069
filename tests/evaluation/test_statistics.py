import numpy as np
import pytest
from hypothesis import given, strategies as st

from hpac_gym.evaluation.statistics import (
    bootstrap_interval,
    interquartile_mean,
    paired_difference,
    probability_of_improvement,
    wilson_interval,
)


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


@given(st.integers(1, 500), st.integers(0, 500))
def test_wilson_bounds_solve_the_score_equation_on_both_sides_of_the_rate(trials, successes):
    successes = min(successes, trials)
    low, high = wilson_interval(successes, trials)
    assert 0 <= low <= successes / trials <= high <= 1
    for bound in (low, high):
        gap = (successes / trials - bound) ** 2 - 1.959963984540054**2 * bound * (
            1 - bound
        ) / trials
        assert gap == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (-1, 5), (6, 5)])
def test_impossible_counts_are_refused(successes, trials):
    with pytest.raises(ValueError, match="successes"):
        wilson_interval(successes, trials)


def outcomes(first: int, second: int, episodes: int) -> tuple[list[bool], list[bool]]:
    """Of two over the same episodes, which that many are won by one of them alone."""
    rest = [True] * (episodes - first - second)
    return [True] * first + [False] * second + rest, [False] * first + [True] * second + rest


def test_paired_difference_is_symmetric_and_tightens_with_agreement():
    estimate, low, high = paired_difference(*outcomes(40, 10, 200))
    assert estimate == pytest.approx(0.15)
    assert low < estimate < high
    assert paired_difference(*outcomes(10, 40, 200)) == pytest.approx((-estimate, -high, -low))
    calm = paired_difference(*outcomes(30, 0, 200))
    assert calm[2] - calm[1] < high - low


def test_paired_difference_equals_agresti_and_mins_formula():
    # b = 12, c = 5 of n = 100: (12.5 − 5.5)/102 ± 1.96·√(18 − 7²/102)/102.
    _, low, high = paired_difference(*outcomes(12, 5, 100))
    assert (low, high) == pytest.approx((-0.011803, 0.149058), abs=1e-5)


def test_interquartile_mean_leaves_out_a_quarter_at_each_end():
    # Of five runs the middle three.
    assert interquartile_mean([[0.9], [0.1], [0.5], [0.6], [0.4]]) == pytest.approx(0.5)
    # Of all four scores the middle two.
    assert interquartile_mean([[0.0, 0.2], [0.4, 9.0]]) == pytest.approx(0.3)
    assert interquartile_mean([[[1.0]], [[2.0]]]).tolist() == [1.0, 2.0]


def test_probability_of_improvement_counts_pairs_of_runs():
    # First task: 3 of 4 pairs are won; second: one win, one tie, two losses, (1 + 0.5) / 4.
    first = [[0.5, 0.5], [0.9, 0.2]]
    second = [[0.4, 0.3], [0.6, 0.5]]
    assert probability_of_improvement(first, second) == pytest.approx((3 / 4 + 1.5 / 4) / 2)
    assert probability_of_improvement(second, first) == pytest.approx(1 - (3 / 4 + 1.5 / 4) / 2)


def test_both_are_what_rliable_gives():
    """Its version 1.2.0, aggregate_iqm and probability_of_improvement, gives 0.55, 0.43333 and
    0.65.
    """
    first = np.array([[0.2, 0.9], [0.5, 0.4], [0.6, 0.7], [0.1, 0.3], [0.8, 0.85]])
    second = [[0.3, 0.5], [0.4, 0.4], [0.7, 0.2], [0.1, 0.6], [0.2, 0.65]]
    assert interquartile_mean(first) == pytest.approx(0.55)
    assert interquartile_mean(first[:, :1]) == pytest.approx(0.433333, abs=1e-6)
    assert probability_of_improvement(first, second) == pytest.approx(0.65)


def test_the_bootstrap_draws_whole_runs():
    """A run is one policy that is judged on all splits, so that its scores go together; `rliable`
    draws the runs of each task apart, since they are trained apart.
    """
    means: list[float] = []

    def mean(scores):
        means.extend(found := scores.mean(axis=(-2, -1)))
        return np.array(found)

    scores = [[0.2, 0.0], [1.0, 0.8]]
    assert bootstrap_interval(mean, scores) == pytest.approx((0.1, 0.9))
    shares = [np.isclose(means, value).mean() for value in (0.1, 0.5, 0.9)]
    assert shares == pytest.approx([1 / 4, 1 / 2, 1 / 4], abs=0.02)
    assert bootstrap_interval(mean, scores) == bootstrap_interval(mean, scores)
    assert bootstrap_interval(mean, [[0.0, 1.0], [1.0, 0.0]]) == (0.5, 0.5)


def test_the_bootstrap_covers_the_mean_of_normal_runs_as_often_as_it_can():
    """With 30 runs about 95 %: a percentile interval of few runs is narrower than it should be."""
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(200):
        low, high = bootstrap_interval(
            lambda s: s.mean(axis=(-2, -1)), rng.normal(size=(30, 1)), draws=400
        )
        covered += low <= 0.0 <= high
    assert 0.88 < covered / 200 < 0.99
