"""How sure a success rate is."""

from math import sqrt

Z_95 = 1.959963984540054  # the standard normal's 97.5 % quantile


def wilson_interval(successes: int, trials: int, z: float = Z_95) -> tuple[float, float]:
    """The interval that a success probability lies in, 95 % by default.

    Wilson's score interval: all p with (successes/trials − p)² ≤ z² p (1 − p) / trials. It stays inside 0…1 and keeps
    its coverage near both ends, where the textbook interval collapses.

    Raises:
        ValueError: Fewer than one trial, or not 0 ≤ successes ≤ trials.
    """
    if trials < 1 or not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes in {trials} trials: need 0 ≤ successes ≤ trials and at least one trial")
    rate = successes / trials
    scale = 1 + z**2 / trials
    centre = (rate + z**2 / (2 * trials)) / scale
    half = z / scale * sqrt(rate * (1 - rate) / trials + z**2 / (4 * trials**2))
    # At the ends the exact bound is 0 or 1; rounding would leave it 1e-17 away.
    return (0.0 if successes == 0 else centre - half, 1.0 if successes == trials else centre + half)


def paired_difference(only_first: int, only_second: int, trials: int, z: float = Z_95) -> tuple[float, float, float]:
    """Difference of two success rates over the same episodes: estimate, lower and upper bound.

    Agresti and Min's adjusted interval for matched pairs: half an episode is added to each of the four outcomes. Only
    the episodes that exactly one of the two won tell them apart.

    Raises:
        ValueError: The counts are negative, or together exceed ``trials``.
    """
    if trials < 1 or min(only_first, only_second) < 0 or only_first + only_second > trials:
        raise ValueError(f"{only_first} and {only_second} discordant pairs do not fit in {trials} trials")
    first, second, total = only_first + 0.5, only_second + 0.5, trials + 2
    centre = (first - second) / total
    half = z * sqrt((first + second) - (first - second) ** 2 / total) / total
    return (only_first - only_second) / trials, max(-1.0, centre - half), min(1.0, centre + half)
