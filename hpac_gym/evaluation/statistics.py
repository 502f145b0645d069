"""Confidence intervals of success rates, for one policy and over the runs of a training."""

from collections.abc import Callable, Iterable
from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaln

Z_95 = 1.959963984540054  # the standard normal's 97.5 % quantile


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """95 % confidence interval of a success probability.

    Wilson's score interval: all p with (successes/trials − p)² ≤ z² p (1 − p) / trials. It stays
    inside 0…1 and keeps its coverage near both ends, where the textbook interval collapses.

    Raises:
        ValueError: Fewer than one trial, or not 0 ≤ successes ≤ trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(
            f"{successes} successes in {trials} trials: need 0 ≤ successes ≤ trials and at least one trial"
        )
    rate = successes / trials
    z = Z_95
    scale = 1 + z**2 / trials
    centre = (rate + z**2 / (2 * trials)) / scale
    half = z / scale * sqrt(rate * (1 - rate) / trials + z**2 / (4 * trials**2))
    # At the ends the exact bound is 0 or 1; rounding would leave it 1e-17 away.
    return (0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half)


def success_counts(successes: int, episodes: int) -> dict[str, Any]:
    """Counts, rate and Wilson interval, by the names that they have in the JSON of every
    evaluation.
    """
    return {
        "episodes": episodes,
        "successes": successes,
        "success_rate": successes / episodes,
        "interval_95": list(wilson_interval(successes, episodes)),
    }


def predicted_rate(successes: ArrayLike, episodes: int, of: int) -> tuple[float, float, float]:
    """Success rate of one more hand of a kind in ``of`` episodes: expectation and 95 % interval.

    Beta-binomial: the hands' own rates have a beta distribution. Its mean has Jeffreys' prior, its
    standard deviation a uniform one (Gelman 2006), up to 0.7 √(p (1 − p)). The interval holds what is
    unknown of both, the spread of the hands, and the luck of the episodes to come.

    Args:
        successes: of each of at least two hands, shape (hands,).
        episodes: of each hand.
        of: episodes that are predicted.

    Raises:
        ValueError: Fewer than two hands, or not 0 ≤ successes ≤ episodes.
    """
    won = np.asarray(successes)
    if won.ndim != 1 or len(won) < 2 or np.any(won < 0) or np.any(won > episodes):
        raise ValueError(f"{won} of {episodes}: need the successes of at least two hands")
    angle = (np.arange(400) + 0.5) / 400 * np.pi  # in which Jeffreys' prior is uniform
    mean, share = np.meshgrid((1 - np.cos(angle)) / 2, np.linspace(0.005, 0.7, 60) ** 2)
    alpha = mean * (1 / share - 1)
    beta = (1 - mean) * (1 / share - 1)
    kinds, count = np.unique(won, return_counts=True)
    likelihood = sum(
        n * (betaln(k + alpha, episodes - k + beta) - betaln(alpha, beta))
        for k, n in zip(kinds, count, strict=True)
    )
    weight = np.exp(likelihood - likelihood.max()).ravel()
    rng = np.random.default_rng(0)  # always the same draws
    at = rng.choice(weight.size, 20_000, p=weight / weight.sum())
    rate = rng.beta(alpha.ravel()[at], beta.ravel()[at])
    low, high = np.quantile(rng.binomial(of, rate) / of, (0.025, 0.975))
    return float(rate.mean()), float(low), float(high)


def rate_text(successes: int, trials: int) -> str:
    """A success rate with its Wilson interval, such as "48.8% (43.9% … 53.6%)"."""
    low, high = wilson_interval(successes, trials)
    return f"{successes / trials:.1%} ({low:.1%} … {high:.1%})"


def paired_difference(first: Iterable[bool], second: Iterable[bool]) -> tuple[float, float, float]:
    """Difference of the success rates of two over the same episodes: estimate, lower and upper
    bound.

    Agresti and Min's adjusted interval for matched pairs: half an episode is added to each of the
    four outcomes. Only the episodes that exactly one of the two won tell them apart.

    Raises:
        ValueError: Not as many episodes of both.
    """
    more = [bool(one) - bool(other) for one, other in zip(first, second, strict=True)]
    gained = sum(more)
    discordant = len(more) - more.count(0) + 1
    total = len(more) + 2
    centre = gained / total
    half = Z_95 * sqrt(discordant - gained**2 / total) / total
    return gained / len(more), max(-1.0, centre - half), min(1.0, centre + half)


def interquartile_mean(scores: ArrayLike) -> NDArray[np.float64]:
    """Mean of the middle half of n scores, without the n // 4 lowest and the n // 4 highest.

    Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice",
    section 4.3, as in `rliable`.

    Args:
        scores: shape (..., runs, tasks).

    Returns:
        Shape (...).
    """
    scores = np.asarray(scores, float)
    ordered = np.sort(scores.reshape(*scores.shape[:-2], -1))
    cut = ordered.shape[-1] // 4
    return ordered[..., cut : ordered.shape[-1] - cut].mean(axis=-1)


def probability_of_improvement(first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """Probability that a run of the first scores higher than a run of the second, ties counting
    half.

    The same paper, section 4.3: the mean over tasks of the Mann–Whitney U divided by the number of
    pairs.

    Args:
        first: shape (..., runs, tasks).
        second: shape (..., other runs, tasks).

    Returns:
        Shape (...).
    """
    gap = np.asarray(first, float)[..., :, None, :] - np.asarray(second, float)[..., None, :, :]
    return (np.sign(gap) + 1).mean(axis=(-3, -2, -1)) / 2


def bootstrap_interval(
    statistic: Callable[..., NDArray[np.float64]],
    *scores: ArrayLike,
    draws: int = 10_000,
) -> tuple[float, float]:
    """95 % percentile interval of a statistic; whole runs are resampled with replacement, since one
    policy is judged on all tasks.

    Args:
        statistic: function of score arrays with a leading axis of draws.
        scores: each of shape (runs, tasks).
        draws: number of resamples, always the same ones.
    """
    rng = np.random.default_rng(0)
    tables = [np.asarray(table, float) for table in scores]
    drawn = [table[rng.integers(len(table), size=(draws, len(table)))] for table in tables]
    low, high = np.percentile(statistic(*drawn), (2.5, 97.5))
    return float(low), float(high)
