"""The fit of one digit, and of the CMC, to its sampling points: bounded robust least squares with a
prior around the design, and draws from the posterior.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are loaded when they are used

from hpac_gym.calibration.combinations import (
    Combination,
    SweptDigit,
    combinations,
    digit_with,
    values,
)
from hpac_gym.calibration.processing import robust_deviation
from hpac_gym.calibration.record import RecordError
from hpac_gym.calibration.samples import DigitSamples, held_out_rows
from hpac_gym.errors import HpacError
from hpac_gym.model import Digit
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import EXTENSION, FLEXION, settled_digit

RADIUS_SPREAD = 1e-3
"""Standard deviation of the logarithm of a radius ratio that is known to be the design's: a
manufacturing tolerance.
"""
ORDER_SPREAD = 1.0
"""Standard deviation of the logarithm of the frictions, of which only the order of magnitude is
known.
"""
DRIVE_SPREAD = 2.0
"""Standard deviation of the drive stretch relative to the design's: no servo stiffness is
published; 8 N·m/rad adds twice it.
"""
DRAWN_DRIVE_SPREAD = 0.2
"""The same among drawn hands (chosen): free space hardly tells how stiff a drive is, but a drawn hand
grips with it.
"""
ZERO_SPREAD = np.deg2rad(12.0)
"""Standard deviation of a servo's zero [rad]: a tooth of a horn's spline with 25 teeth is 14.4°,
and slack adds to it.
"""
WORST_FIT = np.deg2rad(1.0)
"""A residual of this size [rad] means that the model does not describe the hand."""

_OUTLIER = 3.0  # standard deviations, beyond which the loss of a point is linear
_BOUND = 4.0  # standard deviations of the prior
_STRAIGHT = np.pi - 0.02  # rad, included angle of aligned guides
_NOTHING = 1e-7  # value of a combination that the paper's model does not have


class IdentificationError(HpacError, ValueError):
    """The record does not allow a fit; the message states what is missing."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Estimate of one combination of parameters."""

    name: str
    formula: str
    value: float
    low: float
    """Lower end of the 95 % interval, if the hand obeys the laws of the fit and the camera has no
    error but noise and drift; otherwise the number is an effective one, without an interval.
    """
    high: float
    told: float
    """Share of the prior's uncertainty removed by the data, 0…1."""
    away: float = 0.0
    """Distance from the design, in standard deviations of the prior."""


@dataclass(frozen=True, slots=True)
class DigitFit:
    """Result of the fit of one digit."""

    swept: SweptDigit
    estimates: tuple[Estimate, ...]
    samples: DigitSamples
    misfit: float
    """Scatter of the points about the fit, relative to that expected from the samples; 1 for a
    perfect model.
    """
    draws: Array
    """Values of the combinations that the data allow as well, shape (draws, combinations)."""


@dataclass(frozen=True, slots=True)
class Prior:
    """Prior of the unknowns, normal: the logarithm of each combination or the number itself, then drifts."""

    known: tuple[Combination, ...]
    linear: np.ndarray
    centre: Array
    sigma: Array
    lower: Array
    upper: Array

    @classmethod
    def about(cls, base: Digit, spread: float, radii_known: bool, papers_model: bool) -> Prior:
        known = combinations(base)
        names = [item.name for item in known]
        linear = np.array([item.linear for item in known])
        design = values(SweptDigit(base))
        sigma = np.array([spread * item.spread if item.spread else ORDER_SPREAD for item in known])
        zero, drive, alpha, tendon = map(
            names.index, ("servo_zero", "drive_stretch", "alpha", "tendon_friction")
        )
        sigma[zero] = ZERO_SPREAD
        sigma[drive] = DRIVE_SPREAD * design[drive]
        if radii_known:
            sigma[[name.endswith("_ratio") for name in names]] = RADIUS_SPREAD
        if papers_model:
            left_out = [drive, names.index("friction"), tendon, zero]
            design[left_out] = _NOTHING
            sigma[left_out] = 0.1 * _NOTHING
        centre = np.where(linear, design, np.log(np.where(linear, 1.0, design)))
        lower = centre - _BOUND * sigma
        upper = centre + _BOUND * sigma
        lower[drive] = max(lower[drive], 0.1 * _NOTHING)  # a practically rigid tendon
        upper[alpha] = min(upper[alpha], np.log(_STRAIGHT))
        upper[tendon] = min(upper[tendon], np.log(0.5))
        return cls(known, linear, centre, sigma, lower, upper)

    def with_drifts(self, count: int, sigma: float) -> Prior:
        """The same with further unknowns about 0, which have no bounds."""
        unbounded = np.full(count, np.inf)
        return replace(
            self,
            centre=np.append(self.centre, np.zeros(count)),
            sigma=np.append(self.sigma, np.full(count, sigma)),
            lower=np.append(self.lower, -unbounded),
            upper=np.append(self.upper, unbounded),
        )

    def values(self, unknowns: Array) -> Array:
        """Values of the combinations for given unknowns, of which they are the first."""
        numbers = unknowns[..., : len(self.known)]
        return np.where(self.linear, numbers, np.exp(np.where(self.linear, 0.0, numbers)))


@dataclass(frozen=True, slots=True)
class _Problem:
    """Least squares of one digit: unknowns are the combinations, then offset and slope of every
    joint's drift in every segment.
    """

    samples: DigitSamples
    base: Digit
    prior: Prior

    @property
    def seen(self) -> np.ndarray:
        return ~np.isnan(self.samples.joint_pos)

    def misfit(self, unknowns: Array) -> Array:
        """Measured minus predicted angles of the measured points [rad]."""
        angles = predicted(self.samples, digit_with(self.base, self.prior.values(unknowns)))
        line = self.samples.line
        drift = unknowns[len(self.prior.known) :].reshape(line.shape[1], -1)
        missed = self.samples.joint_pos - angles - line @ drift
        return np.asarray(missed[self.seen])

    def rows(self, unknowns: Array, scale: float) -> Array:
        """Misfit and prior, each divided by its standard deviation."""
        return np.concatenate(
            [
                self.misfit(unknowns) / (scale * self.samples.deviation[self.seen]),
                (unknowns - self.prior.centre) / self.prior.sigma,
            ]
        )

    def solve(self, start: Array, scale: float) -> scipy.optimize.OptimizeResult:
        return scipy.optimize.least_squares(
            self.rows,
            start,
            args=(scale,),
            bounds=(self.prior.lower, self.prior.upper),
            x_scale=self.prior.sigma,
            loss=lambda squares: soft_beyond_outliers(squares, int(self.seen.sum())),
            method="trf",
            ftol=1e-6,
            xtol=1e-6,
        )

    def draws(self, start: Array, scale: float, count: int) -> Array:
        """Draws of the combinations' values from the posterior, shape (count, combinations).

        Data and prior get new errors, and the fit is repeated: Bardsley et al. 2014,
        "Randomize-then-optimize". The directions that the data leave open are curved: along a
        tangent, as a normal distribution about the fit has it, the angles do not stay.
        """
        rng = np.random.default_rng(0)
        solution: Array = self.solve(start, scale).x
        fitted = self.rows(solution, scale)
        prior = self.prior

        def within(steps: Array) -> Array:
            return np.clip(solution + prior.sigma * steps, prior.lower, prior.upper)

        across, along = np.linalg.qr(
            scipy.optimize.approx_fprime(
                solution, lambda unknowns: self.rows(unknowns, scale), 1e-6
            )
        )
        drawn = []
        for _ in range(count):
            wanted = fitted + rng.standard_normal(len(fitted))

            def missed(steps: Array, wanted: Array = wanted) -> Array:
                return across.T @ (self.rows(within(steps), scale) - wanted)

            steps = scipy.optimize.root(
                missed,
                np.zeros(len(solution)),
                jac=lambda _: along * prior.sigma,
                options={"xtol": 1e-3, "factor": 1.0},
            ).x
            drawn.append(within(steps))
        return prior.values(np.reshape(drawn, (count, -1)))


def predicted(samples: DigitSamples, swept: SweptDigit) -> Array:
    """Predicted angles of a digit at the points of a sweep, reached in their directions, shape (k,
    joints) [rad].
    """
    angles = np.empty_like(samples.joint_pos)
    for direction in (FLEXION, EXTENSION):
        rows = samples.direction == direction
        if rows.any():
            angles[rows] = settled_digit(
                samples.servo[rows] + swept.servo_zero, swept.digit, swept.friction, direction
            )
    return angles


def soft_beyond_outliers(squares: Array, data: int) -> Array:
    """Loss for SciPy: linear for points beyond `_OUTLIER` deviations, quadratic for the prior,
    after the first `data` rows.
    """
    rho: Array = np.stack([squares, np.ones_like(squares), np.zeros_like(squares)])
    root = np.sqrt(1 + squares[:data] / _OUTLIER**2)
    rho[0, :data] = 2 * _OUTLIER**2 * (root - 1)
    rho[1, :data] = 1 / root
    rho[2, :data] = -0.5 / (_OUTLIER**2 * root**3)
    return rho


def fit_digit(
    samples: DigitSamples, base: Digit, prior: Prior, hold_out: bool, draws: int
) -> DigitFit:
    """Fit a digit.

    Raises:
        RecordError: No digit of this kind makes such points, whatever its numbers.
    """
    fitted = samples.only(~held_out_rows(samples)) if hold_out else samples
    drifts = fitted.line.shape[1] * fitted.joint_pos.shape[1]
    problem = _Problem(fitted, base, prior.with_drifts(drifts, float(np.nanmax(fitted.noise))))
    first = problem.solve(problem.prior.centre, 1.0).x
    scale = max(robust_deviation(problem.misfit(first) / fitted.deviation[problem.seen]), 1.0)
    result = problem.solve(first, scale)
    _check_fit(base.name, problem.misfit(result.x))
    count = len(prior.known)
    covariance = np.linalg.inv(result.jac.T @ result.jac)[:count, :count]
    swept = digit_with(base, prior.values(result.x))
    drawn = np.empty((0, count))
    if draws:
        sigma = problem.prior.sigma.copy()
        drive = [item.name for item in prior.known].index("drive_stretch")
        sigma[drive] = DRAWN_DRIVE_SPREAD * prior.centre[drive]
        stiff = replace(problem, prior=replace(problem.prior, sigma=sigma))
        drawn = stiff.draws(result.x, scale, draws)
    return DigitFit(swept, _estimates(prior, result.x[:count], covariance), samples, scale, drawn)


def _check_fit(name: str, misfit: Array) -> None:
    worst = robust_deviation(misfit)
    if worst > WORST_FIT:
        raise RecordError(
            f"{name}: the model misses the points by {np.degrees(worst):.2g}°, more than {np.degrees(WORST_FIT):.2g}°; does a "
            "tendon slip, or a camera wobble?"
        )


def _estimates(prior: Prior, solution: Array, covariance: Array) -> tuple[Estimate, ...]:
    deviation = np.sqrt(np.diag(covariance))
    told = 1 - np.minimum(deviation / prior.sigma, 1.0)
    ends = (np.clip(solution + k * deviation, prior.lower, prior.upper) for k in (0.0, -1.96, 1.96))
    value, low, high = map(prior.values, ends)
    away = np.abs(solution - prior.centre) / prior.sigma
    return tuple(
        Estimate(item.name, item.formula, *map(float, numbers))
        for item, *numbers in zip(prior.known, value, low, high, told, away, strict=True)
    )


def fit_cmc(
    samples: DigitSamples, base: float, hold_out: bool, draws: int
) -> tuple[tuple[Estimate, Estimate], Array]:
    """Fit gain and zero of the directly driven joint, and draw from their posterior.

    Raises:
        RecordError: No gain and zero make such points.
    """
    rows = ~np.isnan(samples.joint_pos[:, 0])
    if hold_out:
        rows &= ~held_out_rows(samples)
    servo, joint_pos, deviation, line = (
        item[rows]
        for item in (samples.servo, samples.joint_pos[:, 0], samples.deviation[:, 0], samples.line)
    )

    def misfit(solution: Array) -> Array:
        gain, zero = solution[:2]
        data = (
            joint_pos - np.maximum(gain * (servo + zero), 0.0) - line @ solution[2:]
        ) / deviation
        return np.concatenate([data, [zero / ZERO_SPREAD], solution[2:] / samples.noise[0]])

    result = scipy.optimize.least_squares(
        misfit,
        [base, 0.0, *np.zeros(line.shape[1])],
        x_scale=[1.0, ZERO_SPREAD, *np.full(line.shape[1], samples.noise[0])],
        loss=lambda squares: soft_beyond_outliers(squares, len(servo)),
    )
    _check_fit("thumb_cmc", deviation * misfit(result.x)[: len(servo)])
    covariance = np.linalg.inv(result.jac.T @ result.jac)[:2, :2]
    value = result.x[:2]
    spread = np.sqrt(np.diag(covariance))
    told = 1 - np.minimum(spread / [np.inf, ZERO_SPREAD], 1.0)
    gain, zero = np.transpose([value, value - 1.96 * spread, value + 1.96 * spread, told]).tolist()
    estimates = Estimate("cmc_gain", "g_CMC", *gain), Estimate("servo_zero", "rad", *zero)
    rng = np.random.default_rng(0)
    return estimates, rng.multivariate_normal(value, covariance, draws)
