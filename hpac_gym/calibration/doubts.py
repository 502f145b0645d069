"""Remarks on what an identification does not explain, or explains by unusual numbers."""

import numpy as np

from hpac_gym.calibration.combinations import SweptDigit, values
from hpac_gym.calibration.fitting import IdentificationError
from hpac_gym.calibration.identification import Identification
from hpac_gym.model import Hand

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
