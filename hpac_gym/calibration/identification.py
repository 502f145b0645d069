"""Identification of a hand's parameters from a sweep: bounded robust least squares, with the
information in the data, and remarks on what it does not explain.

The points of a sweep are fitted by the static equilibrium in closed form
(`hpac_gym.model.settled`), including drive stretch, direction-dependent friction and servo zeros.
Every digit is fitted separately, in its `combinations`, with a prior around a base hand; the prior
decides where the data is uninformative, and the report states where. The drift line that the rest
poses of a joint determine enters with its remaining uncertainty."""

from dataclasses import dataclass

import numpy as np

from hpac_gym.calibration.combinations import SweptDigit, hand_with, values
from hpac_gym.calibration.fitting import (
    DigitFit,
    Estimate,
    IdentificationError,
    Prior,
    fit_cmc,
    fit_digit,
)
from hpac_gym.calibration.record import Sweep, joints_of_servo
from hpac_gym.calibration.samples import DigitSamples, digit_samples
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINTS, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import FLEXION, digit_statics
from hpac_gym.progress import progress

SPREAD = 0.15
"""Relative standard deviation of each parameter about the base hand."""
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
_CONTRADICTION = 3.0  # standard deviations of the prior, beyond which known radii are contradicted


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
        RecordError: As of `fit_digit` and `fit_cmc`.
    """
    if not 0 < spread < 1:
        raise IdentificationError(f"spread = {spread} must lie between 0 and 1")
    fits = {}
    kept = {}
    for servo, (name, digit) in progress(list(enumerate(base.digits.items())), "digits", shown):
        try:
            samples = _enough(record, servo, base, least_points)
            prior = Prior.about(digit, spread, radii_known, papers_model)
            fit = fit_digit(samples, digit, prior, hold_out, draws)
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
        cmc_samples = _enough(record, len(SERVOS) - 1, base, least_points)
        cmc, cmc_draws = fit_cmc(cmc_samples, base.cmc_gain, hold_out, draws)
    except IdentificationError as error:
        kept["thumb_cmc"] = str(error)
    stops = cmc_samples.stops if cmc_samples else {}
    hand = _identified_hand(base, fits, cmc, stops)
    return Identification(hand, fits, kept, cmc, cmc_samples, cmc_draws)


def _check_radii(fit: DigitFit, prior: Prior) -> None:
    """Reject known radii that would imply implausible strains or ratios."""
    for item, centre, sigma in zip(fit.estimates, prior.centre, prior.sigma, strict=True):
        most = _CONTRADICTION * sigma
        if item.name.endswith(("_strain", "_ratio")) and abs(np.log(item.value) - centre) > most:
            raise IdentificationError(
                f"the record contradicts --radii-known: {item.formula} would be {item.value / np.exp(centre):.4f} times the "
                f"design's, beyond {np.exp(-most):.4f} to {np.exp(most):.4f} times"
            )


def _enough(record: Sweep, servo: int, base: Hand, least_points: int) -> DigitSamples:
    samples = digit_samples(record, servo, base)
    if samples is None:
        joints = ", ".join(JOINTS[joint] for joint in joints_of_servo(servo)[::-1])
        raise IdentificationError(f"no measurement of {joints} while servo {SERVOS[servo]} sweeps")
    seen = samples.only(np.flatnonzero(np.isfinite(samples.joint_pos).any(axis=1)))
    count = len(np.unique(seen.point[seen.direction == FLEXION]))
    if count < least_points:
        at_stops = f" ({samples.at_stops} more are at stops)" if samples.at_stops else ""
        raise IdentificationError(
            f"{count} sampling points of servo {SERVOS[servo]} are measured{at_stops}, fewer than {least_points}"
        )
    share = np.ptp(seen.servo) / (base.servo_max[servo] - base.servo_min[servo])
    if share < LEAST_RANGE:
        raise IdentificationError(
            f"servo {SERVOS[servo]} sweeps {share:.0%} of its range, less than {LEAST_RANGE:.0%}"
        )
    return samples


def _identified_hand(
    base: Hand,
    fits: dict[str, DigitFit],
    cmc: tuple[Estimate, Estimate] | None,
    stops: dict[str, float],
) -> Hand:
    """The hand of the fits; `stops` are the CMC's."""
    stops = dict(stops)
    for fit in fits.values():
        bounds = dict(fit.samples.stops)
        joints = fit.swept.digit.joints
        statics = digit_statics(fit.swept.digit, fit.swept.friction)
        met = [
            (bounds[joint] - statics.offset[i]) / statics.slope[i]
            for i, joint in enumerate(joints)
            if joint in bounds
        ]
        if met:  # the driven joint's range ends where any joint of its digit meets a stop
            bounds[joints[0]] = float(min(met))
        stops |= bounds
    workspace = dict(base.workspace)
    for joint, angle in stops.items():
        low, high = workspace[joint]
        if low < angle < high:
            workspace[joint] = (low, angle)
    swept = {name: fit.swept for name, fit in fits.items()}
    gain_and_zero = (cmc[0].value, cmc[1].value) if cmc else None
    try:
        return hand_with(base, swept, gain_and_zero, workspace=workspace)
    except ParameterError as error:
        raise IdentificationError(f"the identified parameters are invalid: {error}") from None


def doubts(identified: Identification, base: Hand) -> list[str]:
    """Remarks on what an identification does not explain, or explains by unusual numbers.

    Raises:
        IdentificationError: A digit's points scatter so much about the fit that the record is not
            one of a hand of this kind.
    """
    remarks = []
    for name, fit in identified.fits.items():
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
    zero = identified.hand.calibration.servo_zero
    steps = np.array(
        [
            zero[column] / np.median(np.diff(np.unique(np.round(samples.servo, 6))))
            for column, samples in identified.samples.items()
        ]
    )
    if len(steps) > 2 and abs(abs(steps.mean()) - 1) < ALIKE and steps.std() < ALIKE:
        remarks.append(
            f"the zeros of all {len(steps)} servos are about {steps.mean():+.1f} steps of the sweep: is the servo column one "
            f"point {'ahead of' if steps.mean() < 0 else 'behind'} the angles?"
        )
    if identified.cmc:
        gain = identified.cmc[0].value
        if abs(gain / base.cmc_gain - 1) > CMC_UNUSUAL:
            remarks.append(
                f"g_CMC = {gain:.3f} is {gain / base.cmc_gain - 1:+.0%} off the design's {base.cmc_gain:.3f}, and no tendon is "
                "between: are the servo's angles in radians?"
            )
    return remarks
