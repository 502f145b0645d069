"""A hand's parameters from a sweep of it: bounded robust least squares, with what the data can and cannot tell.

The unfiltered samples of a flexion are compared with the hand at rest in closed form (`statics`), drive stretch and friction
included. Every digit is fitted on its own, in the logarithms of its `combinations`, about a base hand whose parameters are known
to some spread; that prior decides where the data says nothing, and the report tells where it did. The line that the rest poses
give for a joint's drift enters with the uncertainty that those poses leave.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from hpac_gym.errors import HpacError, ParameterError
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.study.combinations import TYPICAL_FRICTION, combinations, digit_with, values
from hpac_gym.study.processing import without_drift
from hpac_gym.study.record import PHASES, Sweep
from hpac_gym.study.statics import Friction, settled_digit

SPREAD = 0.15
"""Relative standard deviation of each parameter about the base hand."""
RADIUS_SPREAD = 1e-3
"""The same of radius ratios that are known to be the design's: a workshop's tolerance."""
FRICTION_SPREAD = 1.0
"""The same of friction, of which nobody knows more than its order."""
NOISE = np.deg2rad(0.1)
"""Noise of a sample that the search starts from [rad]; it ends with the data's own."""
LEAST_POINTS = 8
"""Sampling points below which a digit is not fitted."""
LEAST_RANGE = 0.3
"""Share of the servo's range below which a digit is not fitted."""
WORST_FIT = np.deg2rad(1.0)
"""A residual of this size [rad] means that the model does not describe the hand."""

_OUTLIER = 3.0  # standard deviations, from where a sample pulls linearly
_BOUND = 4.0  # standard deviations of the prior
_TIED = 0.5  # correlation of two estimates' errors, from where one cannot be told without the other
_STRAIGHT = np.pi - 0.02  # rad, guides in line


class IdentificationError(HpacError, ValueError):
    """The record cannot support a fit; the message says what is missing."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """One combination of parameters."""

    name: str
    formula: str
    value: float
    low: float
    """Of the 95 % interval."""
    high: float
    told: float
    """How much of the prior's uncertainty the data took away, 0…1."""


@dataclass(frozen=True, slots=True)
class DigitFit:
    """What a record says about one digit."""

    digit: Digit
    friction: Friction
    estimates: tuple[Estimate, ...]
    noise: float
    """Robust standard deviation of a sample about the fit [rad]."""
    samples: int
    outliers: int
    """Samples beyond three standard deviations."""
    confounded: tuple[tuple[str, ...], ...]
    """What the data can hardly tell, each followed by what it cannot be told apart from."""
    missing: tuple[str, ...]
    """Joints without a measurement."""


@dataclass(frozen=True, slots=True)
class Identification:
    """What a record says about a hand."""

    hand: Hand
    fits: dict[str, DigitFit]
    """By digit name."""
    kept: dict[str, str]
    """Digits, and the CMC, that stay the base hand's, and why."""
    cmc_gain: Estimate | None

    @property
    def friction(self) -> dict[str, Friction]:
        """Friction of every digit that was fitted."""
        return {name: fit.friction for name, fit in self.fits.items()}


def predicted_joints(servo: Array, found: Identification) -> Array:
    """Where the identified hand comes to rest in flexion, shapes (..., 6) to (..., 15) [rad]."""
    joint_pos = np.empty((*servo.shape[:-1], len(JOINTS)))
    for column, (name, digit) in enumerate(found.hand.digits.items()):
        friction = found.fits[name].friction if name in found.fits else Friction()
        joint_pos[..., [JOINT_INDEX[joint] for joint in digit.joints]] = settled_digit(servo[..., column], digit, friction)
    joint_pos[..., JOINT_INDEX["thumb_cmc"]] = found.hand.cmc_gain * servo[..., -1]
    return joint_pos


def identify(
    record: Sweep, base: Hand = HPAC, spread: float = SPREAD, radii_known: bool = False, shown: bool = False
) -> Identification:
    """The hand that a record shows.

    Args:
        record: unfiltered, as the camera gave it; NaN where a joint was not measured.
        base: the design; where the data says nothing its numbers stay.
        spread: relative standard deviation of each parameter about the design.
        radii_known: the ratios of joint radii are the design's, to `RADIUS_SPREAD`; without that a free-space sweep
            cannot tell them from the elasticity.
        shown: draw a progress bar.

    Raises:
        IdentificationError: No digit can be fitted, or `spread` is not positive; the message says why.
    """
    if not 0 < spread < 1:
        raise IdentificationError(f"spread = {spread} must lie between 0 and 1")
    fits, kept = {}, {}
    for servo, (name, digit) in progress(list(enumerate(base.digits.items())), "digits", shown):
        try:
            fits[name] = _fit_digit(_samples(record, servo, digit.joints, base), digit, spread, radii_known)
        except IdentificationError as error:
            kept[name] = str(error)
    if not fits:
        raise IdentificationError("the record supports no fit: " + "; ".join(f"{name}: {why}" for name, why in kept.items()))
    gain = None
    try:
        gain = _fit_gain(_samples(record, len(SERVOS) - 1, ("thumb_cmc",), base), base.cmc_gain)
    except IdentificationError as error:
        kept["thumb_cmc"] = str(error)
    digits = {name: fits[name].digit if name in fits else digit for name, digit in base.digits.items()}
    try:
        hand = replace(base, digits=digits, cmc_gain=gain.value if gain else base.cmc_gain)
    except ParameterError as error:
        raise IdentificationError(f"what the record shows is no hand: {error}") from None
    return Identification(hand, fits, kept, gain)


# The data of one digit ---------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Samples:
    """Samples of one digit in flexion, drift taken out, and what that leaves uncertain."""

    servo: Array
    """Of the samples' points, shape (k,) [rad]."""
    point: np.ndarray
    """Index in `servo` of each sample, shape (n,)."""
    joint_pos: Array
    """Shape (n, joints) [rad]; NaN where there is none."""
    line: Array
    """Basis of a drift that the rest poses cannot exclude, each with unit variance for unit noise, shape (n, 2)."""
    missing: tuple[str, ...]


def _samples(record: Sweep, servo: int, joints: tuple[str, ...], base: Hand) -> _Samples:
    columns = [JOINT_INDEX[name] for name in joints]
    corrected = without_drift(record)
    held = (record.swept == servo) & (record.phase == PHASES.index("flexion")) & (record.point >= 0)
    seen = ~np.isnan(record.joint_pos[:, columns])
    rows = np.flatnonzero(held & seen.any(axis=1))
    missing = tuple(name for name, any_seen in zip(joints, seen[held].any(axis=0) if held.any() else [False] * 9, strict=False)
                    if not any_seen)  # fmt: skip
    if not rows.size:
        raise IdentificationError(f"no measurement of {', '.join(joints)} while servo {SERVOS[servo]} sweeps")
    angles, point = np.unique(np.round(record.servo[rows, servo], 9), return_inverse=True)
    if len(angles) < LEAST_POINTS:
        raise IdentificationError(f"{len(angles)} sampling points of servo {SERVOS[servo]}, fewer than {LEAST_POINTS}")
    share = np.ptp(angles) / (base.servo_max[servo] - base.servo_min[servo])
    if share < LEAST_RANGE:
        raise IdentificationError(f"servo {SERVOS[servo]} sweeps {share:.0%} of its range, less than {LEAST_RANGE:.0%}")
    return _Samples(angles, point.reshape(-1), corrected.joint_pos[np.ix_(rows, columns)], _open_line(record, rows), missing)


def _open_line(record: Sweep, rows: np.ndarray) -> Array:
    """What the rest poses leave open of a segment's drift line, shape (n, 2): offset and slope, decorrelated."""
    line = np.zeros((len(rows), 2))
    for segment in record.segments():
        inside = np.isin(rows, segment)
        rest = segment[record.phase[segment] == PHASES.index("rest")]
        if not inside.any() or rest.size < 2:
            continue
        origin = record.time[rest].mean()
        both_ends = record.time[rest[-1]] > record.time[rows[inside]].max()
        time = record.time[rest] - origin
        line[inside, 0] = 1 / np.sqrt(rest.size)
        if both_ends:
            line[inside, 1] = (record.time[rows[inside]] - origin) / np.sqrt((time**2).sum())
    return line


# Least squares ---------------------------------------------------------------------------


def _soft(scaled: Array, data: int) -> Array:
    """SciPy's loss: samples beyond `_OUTLIER` pull linearly, the prior always quadratically."""
    rho = np.stack([scaled, np.ones_like(scaled), np.zeros_like(scaled)])
    root = np.sqrt(1 + scaled[:data] / _OUTLIER**2)
    rho[0, :data] = 2 * _OUTLIER**2 * (root - 1)
    rho[1, :data] = 1 / root
    rho[2, :data] = -0.5 / (_OUTLIER**2 * root**3)
    return rho


def _fit_digit(samples: _Samples, base: Digit, spread: float, radii_known: bool) -> DigitFit:
    known = combinations(base)
    centre = np.log(values(base, TYPICAL_FRICTION))
    sigma = spread * np.array([item.spread for item in known])
    sigma[-1] = FRICTION_SPREAD
    if radii_known:
        sigma[[item.name.endswith("_ratio") for item in known]] = RADIUS_SPREAD
    lower, upper = centre - _BOUND * sigma, centre + _BOUND * sigma
    alpha = [item.name for item in known].index("alpha")
    upper[alpha] = min(upper[alpha], np.log(_STRAIGHT))
    seen = ~np.isnan(samples.joint_pos)
    count, joints = len(known), samples.joint_pos.shape[1]

    def misfit(solution: Array) -> Array:
        digit, friction = digit_with(base, np.exp(solution[:count]))
        model = settled_digit(samples.servo, digit, friction)[samples.point]
        drift = samples.line @ solution[count:].reshape(2, joints)
        return (samples.joint_pos - model)[seen] - drift[seen]

    def solve(start: Array, noise: float) -> optimize.OptimizeResult:
        def rows(solution: Array) -> Array:
            prior = (solution[:count] - centre) / sigma
            return np.concatenate([misfit(solution) / noise, prior, solution[count:] / noise])

        free = np.full(2 * joints, np.inf)
        return optimize.least_squares(
            rows,
            start,
            bounds=(np.concatenate([lower, -free]), np.concatenate([upper, free])),
            x_scale=np.concatenate([sigma, np.full(2 * joints, noise)]),
            loss=lambda scaled: _soft(scaled, int(seen.sum())),
            method="trf",
            ftol=1e-6,
            xtol=1e-6,
        )

    noise, solution = NOISE, np.concatenate([centre, np.zeros(2 * joints)])
    for _ in range(2):
        result = solve(solution, noise)
        solution = result.x
        noise = max(1.4826 * float(np.median(np.abs(misfit(solution)))), 1e-6)
    result = solve(solution, noise)
    if noise > WORST_FIT:
        raise IdentificationError(
            f"the model misses the samples by {np.degrees(noise):.2g}°, more than {np.degrees(WORST_FIT):.2g}°"
        )
    covariance = np.linalg.inv(result.jac.T @ result.jac)[:count, :count]
    digit, friction = digit_with(base, np.exp(result.x[:count]))
    return DigitFit(
        digit=digit,
        friction=friction,
        estimates=_estimates(known, result.x[:count], covariance, sigma),
        noise=noise,
        samples=int(seen.sum()),
        outliers=int((np.abs(misfit(result.x)) > _OUTLIER * noise).sum()),
        confounded=_confounded([item.name for item in known], covariance, sigma),
        missing=samples.missing,
    )


def _estimates(known, solution: Array, covariance: Array, sigma: Array) -> tuple[Estimate, ...]:
    deviation = np.sqrt(np.diag(covariance))
    told = 1 - np.minimum(deviation / sigma, 1.0)
    return tuple(
        Estimate(item.name, item.formula, *(float(np.exp(x + k * s)) for k in (0.0, -1.96, 1.96)), float(share))
        for item, x, s, share in zip(known, solution, deviation, told, strict=True)
    )


def _confounded(names: list[str], covariance: Array, sigma: Array) -> tuple[tuple[str, ...], ...]:
    """Each combination that keeps over half of its prior's uncertainty, and those whose errors go with its own."""
    deviation = np.sqrt(np.diag(covariance))
    correlation = np.abs(covariance / np.outer(deviation, deviation))
    groups = []
    for row in np.flatnonzero(deviation > 0.5 * sigma):
        partners = [name for name, part in zip(names, correlation[row], strict=True) if part > _TIED and name != names[row]]
        groups.append((names[row], *partners))
    return tuple(groups)


def _fit_gain(samples: _Samples, base: float) -> Estimate:
    seen = ~np.isnan(samples.joint_pos[:, 0])
    servo, joint_pos, line = samples.servo[samples.point][seen], samples.joint_pos[seen, 0], samples.line[seen]

    def rows(solution: Array) -> Array:
        return np.concatenate([(joint_pos - solution[0] * servo - line @ solution[1:]) / NOISE, solution[1:] / NOISE])

    result = optimize.least_squares(rows, [base, 0.0, 0.0], loss=lambda scaled: _soft(scaled, len(servo)))
    deviation = float(np.sqrt(np.linalg.inv(result.jac.T @ result.jac)[0, 0]))
    value = float(result.x[0])
    return Estimate("cmc_gain", "g_CMC", value, value - 1.96 * deviation, value + 1.96 * deviation, 1.0)
