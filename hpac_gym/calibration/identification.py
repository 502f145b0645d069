"""Identification of a hand's parameters from a sweep: bounded robust least squares, with the
information in the data.

The points of a sweep are fitted by the static equilibrium in closed form
(`hpac_gym.model.settled`), including drive stretch, direction-dependent friction and servo zeros.
Every digit is fitted separately, in its `combinations`, with a prior around a base hand; the prior
decides where the data is uninformative, and the report states where. The drift line that the rest
poses of a joint determine enters with its remaining uncertainty."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from hpac_gym.calibration.combinations import (
    Combination,
    SweptDigit,
    combinations,
    digit_with,
    values,
)
from hpac_gym.calibration.processing import robust_deviation
from hpac_gym.calibration.record import Sweep
from hpac_gym.calibration.samples import DigitSamples, digit_samples
from hpac_gym.errors import HpacError, ParameterError
from hpac_gym.model import HPAC, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.parameters import Calibration
from hpac_gym.model.settled import EXTENSION, FLEXION, digit_statics, settled_digit
from hpac_gym.progress import progress

SPREAD = 0.15
"""Relative standard deviation of each parameter about the base hand."""
RADIUS_SPREAD = 1e-3
"""The same for radius ratios that are known to be the design's: a manufacturing tolerance."""
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
LEAST_POINTS = 8
"""Least number of sampling points for a fit of a digit."""
LEAST_RANGE = 0.3
"""Least swept share of the servo's range for a fit of a digit."""
MISFIT = 2.0
"""Scatter about the fit, relative to that of the samples, above which the model is in doubt."""
MOST_MISFIT = 10.0
"""The same, above which a record is refused."""
UNUSUAL = 1.5
"""Distance from the design, in standard deviations of the prior, above which a number is told."""
SCALE_OFF = 0.07
"""Relative deviation of all of a digit's ratios, in one direction, above which it is told (chosen)."""
ALIKE = 0.35
"""Most scatter of the servos' zeros, in steps of the sweep, at which all of them are told to be one
step (chosen).
"""
CMC_UNUSUAL = 0.05
"""Relative deviation of g_CMC above which it is told: the joint is driven without a tendon."""
WORST_FIT = np.deg2rad(1.0)
"""A residual of this size [rad] means that the model does not describe the hand."""
HELD_OUT_EVERY = 4
"""One in this many sampling points is held out for evaluation."""

_OUTLIER = 3.0  # standard deviations, beyond which the loss of a point is linear
_CONTRADICTION = 3.0  # standard deviations of the prior, beyond which known radii are contradicted
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
class Identification:
    """Result of the identification of a hand."""

    hand: Hand
    """The identified hand, with its `calibration` and a workspace that ends at the detected stops.
    """
    fits: dict[str, DigitFit]
    """Fits by digit name."""
    kept: dict[str, str]
    """Digits (or the CMC) that keep the base hand's parameters, with the reason."""
    cmc: tuple[Estimate, Estimate] | None
    """g_CMC and the zero of servo 6."""
    cmc_samples: DigitSamples | None
    cmc_draws: Array | None
    """g_CMC and zero that the data allow as well, shape (draws, 2)."""

    @property
    def samples(self) -> dict[int, DigitSamples]:
        """Sampling points of every fitted servo, by the servo's index."""
        fitted = {
            column: self.fits[name].samples
            for column, name in enumerate(self.hand.digits)
            if name in self.fits
        }
        return fitted | ({len(SERVOS) - 1: self.cmc_samples} if self.cmc_samples else {})


def identify(
    record: Sweep,
    base: Hand = HPAC,
    spread: float = SPREAD,
    radii_known: bool = False,
    hold_out: bool = False,
    least_points: int = LEAST_POINTS,
    papers_model: bool = False,
    shown: bool = False,
    draws: int = 0,
) -> Identification:
    """Identify the hand of a record.

    Args:
        record: unfiltered camera samples; NaN where a joint was not measured.
        base: the design, whose parameters remain where the data is uninformative.
        spread: relative standard deviation of each parameter about the design.
        radii_known: the ratios of joint radii are the design's, to `RADIUS_SPREAD`; otherwise a
            free-space sweep cannot distinguish them from the elasticity.
        hold_out: leave every fourth point (`held_out_rows`) out of the fit, for evaluation.
        least_points: least number of sampling points of a digit.
        papers_model: fit only Eqs. (5), (7), (12), (13): a rigid drive, no friction, no zero.
        shown: draw a progress bar.
        draws: number of draws from the posterior, always the same ones.

    Raises:
        IdentificationError: No digit can be fitted, or `spread` is out of bounds; the message
            states the reason.
    """
    if not 0 < spread < 1:
        raise IdentificationError(f"spread = {spread} must lie between 0 and 1")
    fits = {}
    kept = {}
    for servo, (name, digit) in progress(list(enumerate(base.digits.items())), "digits", shown):
        try:
            samples = _enough(record, servo, digit.joints, base, least_points)
            prior = _Prior.about(digit, spread, radii_known, papers_model)
            fit = _fit_digit(samples, digit, prior, hold_out, draws)
            if radii_known:
                _check_radii(fit, prior)
            fits[name] = fit
        except IdentificationError as error:
            kept[name] = str(error)
    if not fits:
        raise IdentificationError(
            "the record supports no fit: "
            + "; ".join(f"{name}: {why}" for name, why in kept.items())
        )
    cmc = cmc_samples = cmc_draws = None
    try:
        cmc_samples = _enough(record, len(SERVOS) - 1, ("thumb_cmc",), base, least_points)
        cmc, cmc_draws = _fit_cmc(cmc_samples, base.cmc_gain, hold_out, draws)
    except IdentificationError as error:
        kept["thumb_cmc"] = str(error)
    hand = _identified_hand(base, fits, cmc)
    return Identification(hand, fits, kept, cmc, cmc_samples, cmc_draws)


def doubts(found: Identification, base: Hand) -> list[str]:
    """Remarks on what an identification does not explain, or explains by unusual numbers.

    Raises:
        IdentificationError: A digit's points scatter so much about the fit that the record is not
            one of a hand of this kind.
    """
    remarks = []
    for name, fit in found.fits.items():
        scatter = f"{name}: the points scatter {fit.misfit:.1f} times as much about the fit as their samples say"
        if fit.misfit > MOST_MISFIT:
            raise IdentificationError(
                f"{scatter}, at most {MOST_MISFIT:g} times is accepted; does a tendon slip, or a camera wobble?"
            )
        if fit.misfit > MISFIT:
            remarks.append(f"{scatter}: the hand, or the camera, does what the model does not have")
        unusual = " and ".join(
            f"{item.name} = {item.value:.4g} ({item.formula}) is {item.away:.1f}"
            for item in fit.estimates
            if item.away > UNUSUAL and "friction" not in item.name
        )
        if unusual:
            remarks.append(
                f"{name}: {unusual} standard deviations from the design; are the servo's angles in radians, "
                "and at their own points?"
            )
        design = values(SweptDigit(base.digits[name]))
        off = [
            float(item.value / nominal - 1)
            for item, nominal in zip(fit.estimates, design, strict=True)
            if item.name.endswith("_ratio")
        ]
        if len(off) > 1 and (min(off) > SCALE_OFF or max(off) < -SCALE_OFF):
            remarks.append(
                f"{name}: all joints turn {np.mean(off):+.0%} for the same angle of the root joint, against the design: is the "
                "scale of the root joint's angle off, or its radius?"
            )
    steps = np.array(list(_zeros_in_steps(found)))
    if len(steps) > 2 and abs(abs(steps.mean()) - 1) < ALIKE and steps.std() < ALIKE:
        remarks.append(
            f"the zeros of all {len(steps)} servos are about {steps.mean():+.1f} steps of the sweep: is the servo column one "
            f"point {'ahead of' if steps.mean() < 0 else 'behind'} the angles?"
        )
    if found.cmc:
        gain = found.cmc[0].value
        if abs(gain / base.cmc_gain - 1) > CMC_UNUSUAL:
            remarks.append(
                f"g_CMC = {gain:.3f} is {gain / base.cmc_gain - 1:+.0%} off the design's {base.cmc_gain:.3f}, and no tendon is "
                "between: are the servo's angles in radians?"
            )
    return remarks


def _zeros_in_steps(found: Identification) -> Iterator[float]:
    """The servos' zeros in units of the sweep's steps."""
    zero = found.hand.calibration.servo_zero
    for column, samples in found.samples.items():
        yield float(zero[column] / np.median(np.diff(np.unique(np.round(samples.servo, 6)))))


def held_out_rows(samples: DigitSamples) -> np.ndarray:
    """Mask of the held-out points, shape (k,): every fourth sampling point, excluding the first and
    the last.
    """
    rows: np.ndarray = samples.point % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
    return rows


def _enough(
    record: Sweep, servo: int, joints: tuple[str, ...], base: Hand, least_points: int
) -> DigitSamples:
    samples = digit_samples(record, servo, joints, base)
    if samples is None:
        raise IdentificationError(
            f"no measurement of {', '.join(joints)} while servo {SERVOS[servo]} sweeps"
        )
    count = len(np.unique(samples.point[samples.direction == FLEXION]))
    if count < least_points:
        at_stops = f" ({samples.at_stops} more are at stops)" if samples.at_stops else ""
        raise IdentificationError(
            f"{count} sampling points of servo {SERVOS[servo]}{at_stops}, fewer than {least_points}"
        )
    share = np.ptp(samples.servo) / (base.servo_max[servo] - base.servo_min[servo])
    if share < LEAST_RANGE:
        raise IdentificationError(
            f"servo {SERVOS[servo]} sweeps {share:.0%} of its range, less than {LEAST_RANGE:.0%}"
        )
    return samples


def _identified_hand(
    base: Hand, fits: dict[str, DigitFit], cmc: tuple[Estimate, Estimate] | None
) -> Hand:
    digits = dict(base.digits)
    workspace = dict(base.workspace)
    zero = list(base.calibration.servo_zero)
    friction = list(base.calibration.friction)
    for column, name in enumerate(base.digits):
        if name not in fits:
            continue
        fit = fits[name]
        digits[name] = fit.swept.digit
        friction[column] = fit.swept.friction
        zero[column] = fit.swept.servo_zero
        bounds = dict(fit.samples.stops)
        joints = digits[name].joints
        statics = digit_statics(fit.swept.digit, fit.swept.friction)
        met = [
            (bounds[joint] - statics.offset[i]) / statics.slope[i]
            for i, joint in enumerate(joints)
            if joint in bounds
        ]
        if met:  # the driven joint's range ends where any joint of its digit meets a stop
            bounds[joints[0]] = float(min(met))
        for joint, angle in bounds.items():
            low, high = workspace[joint]
            if low < angle < high:
                workspace[joint] = (low, angle)
    if cmc:
        zero[-1] = cmc[1].value
    try:
        return replace(
            base,
            digits=digits,
            workspace=workspace,
            cmc_gain=cmc[0].value if cmc else base.cmc_gain,
            calibration=Calibration(tuple(zero), tuple(friction)),
        )
    except ParameterError as error:
        raise IdentificationError(f"the identified parameters are invalid: {error}") from None


# Least squares ---------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Prior:
    """Prior of the combinations: normal, in the logarithm of each or in the number itself."""

    known: tuple[Combination, ...]
    linear: np.ndarray
    centre: Array
    sigma: Array
    lower: Array
    upper: Array

    @classmethod
    def about(cls, base: Digit, spread: float, radii_known: bool, papers_model: bool) -> _Prior:
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

    def drive_known(self, spread: float) -> _Prior:
        """The same, with the drive's stiffness as the design's."""
        sigma = self.sigma.copy()
        drive = [item.name for item in self.known].index("drive_stretch")
        sigma[drive] = spread * self.centre[drive]
        return replace(self, sigma=sigma)

    def values(self, unknowns: Array) -> Array:
        """Values of the combinations for given unknowns."""
        numbers: Array = np.where(
            self.linear, unknowns, np.exp(np.where(self.linear, 0.0, unknowns))
        )
        return numbers


@dataclass(frozen=True, slots=True)
class _Problem:
    """Least squares of one digit: unknowns are the combinations, then offset and slope of every
    joint's drift.
    """

    samples: DigitSamples
    base: Digit
    prior: _Prior

    @property
    def seen(self) -> np.ndarray:
        return ~np.isnan(self.samples.joint_pos)

    def misfit(self, unknowns: Array) -> Array:
        """Measured minus predicted angles of the measured points [rad]."""
        count = len(self.prior.centre)
        swept = digit_with(self.base, self.prior.values(unknowns[:count]))
        drift = self.samples.line @ unknowns[count:].reshape(2, -1)
        missed = self.samples.joint_pos - predicted(self.samples, swept) - drift
        of_seen: Array = missed[self.seen]
        return of_seen

    def rows(self, unknowns: Array, scale: float) -> Array:
        """Misfit and prior, each divided by its standard deviation."""
        count = len(self.prior.centre)
        prior = (unknowns[:count] - self.prior.centre) / self.prior.sigma
        drift = unknowns[count:].reshape(2, -1) / np.nanmax(self.samples.noise)
        return np.concatenate(
            [
                self.misfit(unknowns) / (scale * self.samples.deviation[self.seen]),
                prior,
                drift.ravel(),
            ]
        )

    @property
    def bounds(self) -> tuple[Array, Array]:
        free = np.full(2 * self.samples.joint_pos.shape[1], np.inf)
        return np.append(self.prior.lower, -free), np.append(self.prior.upper, free)

    @property
    def unit(self) -> Array:
        """A typical size of every unknown."""
        noise = float(np.nanmax(self.samples.noise))
        return np.append(self.prior.sigma, np.full(2 * self.samples.joint_pos.shape[1], noise))

    def solve(self, start: Array, scale: float) -> optimize.OptimizeResult:
        return optimize.least_squares(
            self.rows,
            start,
            args=(scale,),
            bounds=self.bounds,
            x_scale=self.unit,
            loss=lambda squares: soft_beyond_outliers(squares, int(self.seen.sum())),
            method="trf",
            ftol=1e-6,
            xtol=1e-6,
        )

    def draws(self, found: Array, scale: float, count: int) -> Array:
        """Draws of the combinations' values from the posterior, shape (count, combinations).

        Data and prior get new errors, and the fit is repeated: Bardsley et al. 2014,
        "Randomize-then-optimize". The directions that the data leave open are curved: along a
        tangent, as a normal distribution about the fit has it, the angles do not stay. The drive is
        as stiff as the design's, to `DRAWN_DRIVE_SPREAD`.
        """
        held = replace(self, prior=self.prior.drive_known(DRAWN_DRIVE_SPREAD))
        return held.drawn(held.solve(found, scale).x, scale, count)

    def drawn(self, found: Array, scale: float, count: int) -> Array:
        """The draws about a solution."""
        rng = np.random.default_rng(0)
        fitted = self.rows(found, scale)
        unit = self.unit
        low, high = self.bounds

        def within(steps: Array) -> Array:
            clipped: Array = np.clip(found + unit * steps, low, high)
            return clipped

        across, along = np.linalg.qr(
            optimize.approx_fprime(found, lambda unknowns: self.rows(unknowns, scale), 1e-6)
        )
        drawn = []
        for _ in range(count):
            wanted = fitted + rng.standard_normal(len(fitted))

            def missed(steps: Array, wanted: Array = wanted) -> Array:
                return across.T @ (self.rows(within(steps), scale) - wanted)

            steps = optimize.root(
                missed,
                np.zeros(len(found)),
                jac=lambda _: along * unit,
                options={"xtol": 1e-3, "factor": 1.0},
            ).x
            drawn.append(within(steps)[: len(self.prior.centre)])
        return self.prior.values(np.reshape(drawn, (count, len(self.prior.centre))))


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


def _fit_digit(
    samples: DigitSamples, base: Digit, prior: _Prior, hold_out: bool, draws: int
) -> DigitFit:
    fitted = samples.only(np.flatnonzero(~held_out_rows(samples))) if hold_out else samples
    problem = _Problem(fitted, base, prior)
    count = len(prior.centre)
    start = np.concatenate([prior.centre, np.zeros(2 * fitted.joint_pos.shape[1])])
    first = problem.solve(start, 1.0).x
    scale = max(robust_deviation(problem.misfit(first) / fitted.deviation[problem.seen]), 1.0)
    result = problem.solve(first, scale)
    worst = robust_deviation(problem.misfit(result.x))
    if worst > WORST_FIT:
        raise IdentificationError(
            f"the model misses the points by {np.degrees(worst):.2g}°, more than {np.degrees(WORST_FIT):.2g}°"
        )
    found = result.x[:count]
    covariance = np.linalg.inv(result.jac.T @ result.jac)[:count, :count]
    swept = digit_with(base, prior.values(found))
    drawn = problem.draws(result.x, scale, draws) if draws else np.empty((0, count))
    return DigitFit(swept, _estimates(prior, found, covariance), samples, scale, drawn)


def _check_radii(fit: DigitFit, prior: _Prior) -> None:
    """Reject known radii that would imply implausible strains or ratios."""
    for item, centre, sigma in zip(fit.estimates, prior.centre, prior.sigma, strict=True):
        if (
            item.name.endswith(("_strain", "_ratio"))
            and abs(np.log(item.value) - centre) > _CONTRADICTION * sigma
        ):
            factor = item.value / np.exp(centre)
            message = f"the record contradicts --radii-known: {item.formula} would be {factor:.2f} times the design's"
            raise IdentificationError(message)


def _estimates(prior: _Prior, solution: Array, covariance: Array) -> tuple[Estimate, ...]:
    deviation = np.sqrt(np.diag(covariance))
    told = 1 - np.minimum(deviation / prior.sigma, 1.0)
    ends = (np.clip(solution + k * deviation, prior.lower, prior.upper) for k in (0.0, -1.96, 1.96))
    value, low, high = map(prior.values, ends)
    away = np.abs(solution - prior.centre) / prior.sigma
    return tuple(
        Estimate(item.name, item.formula, *map(float, numbers))
        for item, *numbers in zip(prior.known, value, low, high, told, away, strict=True)
    )


def _fit_cmc(
    samples: DigitSamples, base: float, hold_out: bool, draws: int
) -> tuple[tuple[Estimate, Estimate], Array]:
    """Fit gain and zero of the directly driven joint, and draw from their posterior."""
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

    result = optimize.least_squares(
        misfit,
        [base, 0.0, 0.0, 0.0],
        x_scale=[1.0, ZERO_SPREAD, samples.noise[0], samples.noise[0]],
        loss=lambda squares: soft_beyond_outliers(squares, len(servo)),
    )
    covariance = np.linalg.inv(result.jac.T @ result.jac)[:2, :2]
    spread = np.sqrt(np.diag(covariance))

    def estimate(name: str, formula: str, prior: float, place: int) -> Estimate:
        x = float(result.x[place])
        half = 1.96 * float(spread[place])
        told = 1 - min(float(spread[place]) / prior, 1.0)
        return Estimate(name, formula, x, x - half, x + half, told)

    estimates = (
        estimate("cmc_gain", "g_CMC", np.inf, 0),
        estimate("servo_zero", "rad", float(ZERO_SPREAD), 1),
    )
    rng = np.random.default_rng(0)
    return estimates, rng.multivariate_normal(result.x[:2], covariance, draws)
