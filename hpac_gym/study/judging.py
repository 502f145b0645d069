"""Whether a record can be of a hand at all: what `hpac sweep` and `hpac calibrate` refuse, before they believe a number."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import stats

from hpac_gym.model import JOINTS, SERVOS, Hand, elastic_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.study.processing import FAR, LEAST_NOISE, without_drift
from hpac_gym.study.record import PHASES, RecordError, Sweep, joints_of_servo

LEAST_REST = 5
"""Samples at rest, before or after the motion, that a segment needs."""
LEAST_SHARE, MOST_SHARE = 0.5, 2.0
"""How far a swept joint turns, over how far the design's does."""
RATIO_TOLERANCE = 0.15
"""Relative deviation of a joint's angle over its root joint's from the design's: two radii off by 5 % give 0.11."""
MOST_GARBAGE = 0.1
"""Share of a joint's samples that may lie far from the others of their sampling point."""
MOST_NOISE = np.deg2rad(1.0)
"""Of a sample about the others of its sampling point [rad]."""
SHOWN = 3
"""Faults that the message spells out."""
_HINT = "are labels exchanged?"
_FLEXION = PHASES.index("flexion")


def judged(sweep: Sweep, base: Hand) -> list[str]:
    """Refuse a record that cannot be of a hand of this design; returns remarks on what it cannot tell.

    Args:
        sweep: unfiltered.
        base: the hand's design.

    Raises:
        RecordError: A segment has no rest, sweeps another servo than it says, or has a joint that rests, moves with another
            servo, turns in another ratio, or is measured too badly. The message gives the first faults.
    """
    corrected = without_drift(sweep)
    faults, remarks = [], []
    for rows in sweep.segments():
        flexed = rows[(sweep.phase[rows] == _FLEXION) & (sweep.point[rows] >= 0)]
        swept = int(sweep.swept[rows[0]])
        fault = _fault_of_segment(sweep, rows, flexed, swept)
        if fault:
            faults.append(fault)
        elif len(np.unique(sweep.point[flexed])) >= 3:
            faults += _faults_of_joints(corrected, flexed, swept, base)
            remarks += _remarks(corrected, flexed, swept, base)
    if faults:
        told = list(dict.fromkeys(faults))
        more = f"; and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
        raise RecordError(f"the record is refused: {'; '.join(told[:SHOWN])}{more}")
    return list(dict.fromkeys(remarks))


def point_medians(sweep: Sweep, rows: np.ndarray, joint: int) -> tuple[Array, Array, Array]:
    """Median of a joint at each sampling point, and how far each sample is off it.

    Args:
        sweep: the record.
        rows: samples at the sampling points of one phase of one segment.
        joint: index in `JOINTS`.

    Returns:
        Servo angles (points, 6) [rad], medians (points,) [rad], deviations (samples,) [rad]; NaN where nothing was measured.
    """
    points, place = np.unique(sweep.point[rows], return_inverse=True)
    values = sweep.joint_pos[rows, joint]
    medians, servo = np.full(len(points), np.nan), np.empty((len(points), len(SERVOS)))
    for number in range(len(points)):
        mine = place == number
        servo[number] = sweep.servo[rows[mine]].mean(axis=0)
        if not np.isnan(values[mine]).all():
            medians[number] = np.nanmedian(values[mine])
    return servo, medians, values - medians[place]


def noise_of(deviations: Array) -> float:
    """Robust standard deviation of samples about their point's median, NaN left out [rad]."""
    seen = deviations[~np.isnan(deviations)]
    return max(1.4826 * float(np.median(np.abs(seen))), LEAST_NOISE) if seen.size else LEAST_NOISE


def _fault_of_segment(sweep: Sweep, rows: np.ndarray, flexed: np.ndarray, swept: int) -> str:
    where = f"trial {sweep.trial[rows[0]]}, sweep of {SERVOS[swept]}"
    if not flexed.size:
        return ""
    rest = int((sweep.phase[rows] == PHASES.index("rest")).sum())
    if rest < LEAST_REST:
        return f"{where}: {rest} samples are marked 'rest', at least {LEAST_REST} are needed to take out offset and drift"
    travel = np.ptp(sweep.servo[flexed], axis=0)
    if travel.argmax() != swept:
        moved = int(travel.argmax())
        return f"{where}: servo {SERVOS[moved]} moves {travel[moved]:.2f} rad, {SERVOS[swept]} {travel[swept]:.2f} rad; {_HINT}"
    return ""


def _faults_of_joints(sweep: Sweep, rows: np.ndarray, swept: int, base: Hand) -> Iterator[str]:
    where = f"sweep of {SERVOS[swept]}"
    design = elastic_joints_from_servo(np.clip(point_medians(sweep, rows, 0)[0], base.servo_min, base.servo_max), base)
    own, well = joints_of_servo(swept), True
    for joint in own:
        _, medians, deviations = point_medians(sweep, rows, joint)
        seen = ~np.isnan(medians)
        if seen.sum() < 3:
            continue
        noise = noise_of(deviations)
        if noise > MOST_NOISE:
            well = False
            yield f"{where}: {JOINTS[joint]} is measured to {np.degrees(noise):.1f}°, {np.degrees(MOST_NOISE):.0f}° is needed"
            continue
        garbage = float((np.abs(deviations[~np.isnan(deviations)]) > FAR * noise).mean())
        if garbage > MOST_GARBAGE:
            well = False
            yield (
                f"{where}: {garbage:.0%} of the samples of {JOINTS[joint]} lie more than {np.degrees(FAR * noise):.1f}° from the "
                f"others of their point, {MOST_GARBAGE:.0%} may"
            )
            continue
        share = _travel(medians[seen]) / _travel(design[seen, joint])
        if not LEAST_SHARE <= share <= MOST_SHARE:
            well = False
            movers = [JOINTS[other] for other in range(len(JOINTS)) if other not in own and _moves(sweep, rows, other)]
            others = f", while {', '.join(movers)} move" if movers else ""
            yield f"{where}: {JOINTS[joint]} turns {share:.2f} of what the design's does{others}; does it rest, or {_HINT}"
    if well and SERVOS[swept] != "thumb_cmc":
        for joint, ratio, wanted in _ratios(sweep, rows, swept, base):
            if abs(np.log(ratio / wanted)) > np.log1p(RATIO_TOLERANCE):
                yield (
                    f"{where}: {JOINTS[joint]} turns {ratio:.2f} rad for each rad of {SERVOS[swept]}, the design's "
                    f"{wanted:.2f} within {RATIO_TOLERANCE:.0%}; {_HINT[:-1]}, or is this another hand?"
                )


def _remarks(sweep: Sweep, rows: np.ndarray, swept: int, base: Hand) -> Iterator[str]:
    if SERVOS[swept] == "thumb_cmc":
        return
    for joint, ratio, wanted in _ratios(sweep, rows, swept, base):
        if wanted < 1 < ratio and JOINTS[joint].endswith("_dip"):
            yield (
                f"{JOINTS[joint]} turns {ratio:.3f} rad for each rad of {SERVOS[swept]}, the design's {wanted:.3f}: exchanged "
                f"labels of the two look like this, and so do radii that are off by some percent; the record cannot tell which"
            )


def _ratios(sweep: Sweep, rows: np.ndarray, swept: int, base: Hand) -> Iterator[tuple[int, float, float]]:
    """Joint, its angle over the root joint's, and the design's, for the joints beyond the root that can be compared."""
    root = JOINTS.index(SERVOS[swept])
    medians = {joint: point_medians(sweep, rows, joint)[1] for joint in joints_of_servo(swept)}
    for joint, values in medians.items():
        seen = ~np.isnan(values) & ~np.isnan(medians[root])
        if joint == root or seen.sum() < 3 or _travel(medians[root][seen]) < 0.1 or _travel(values[seen]) < 0.1:
            continue
        ratio = float(stats.theilslopes(values[seen], medians[root][seen]).slope)
        yield joint, max(ratio, 1e-3), float(base.elastic_ratio[joint])


def _travel(values: Array) -> float:
    low, high = np.quantile(values, (0.05, 0.95))
    return float(high - low)


def _moves(sweep: Sweep, rows: np.ndarray, joint: int) -> bool:
    medians = point_medians(sweep, rows, joint)[1]
    seen = medians[~np.isnan(medians)]
    return seen.size >= 3 and _travel(seen) > 0.2
