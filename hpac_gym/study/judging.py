"""Checks whether a record can be of this hand at all, which `hpac sweep` and `hpac calibrate` make before anything else."""

from __future__ import annotations

import numpy as np

from hpac_gym.model import JOINTS, SERVOS, Hand, elastic_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.study.processing import FAR, LEAST_NOISE, group_means, without_drift
from hpac_gym.study.record import FLEXING, REST, RecordError, Sweep, joints_of_servo

LEAST_REST = 5
"""Samples at rest, before or after the motion, that a segment needs."""
LEAST_SHARE, MOST_SHARE = 0.5, 2.0
"""How far a swept joint turns, over how far the design's does."""
RATIO_TOLERANCE = 0.15
"""Relative deviation of a joint's angle over its root joint's from the design's: two radii off by 5 % give 0.11."""
MOST_GARBAGE = 0.1
"""Share of a joint's samples that may lie far from the others of their sampling point."""
MOST_NOISE = np.deg2rad(1.0)
"""Largest noise of a sample about the others of its sampling point [rad]."""
SHOWN = 3
"""Faults that the message spells out."""
_HINT = "are labels exchanged?"


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
        flexed = rows[(sweep.phase[rows] == FLEXING) & (sweep.point[rows] >= 0)]
        if not flexed.size:
            continue
        swept = int(sweep.swept[rows[0]])
        where = f"trial {sweep.trial[rows[0]]}, sweep of {SERVOS[swept]}"
        rest = int((sweep.phase[rows] == REST).sum())
        travel = np.ptp(sweep.servo[flexed], axis=0)
        moved = int(travel.argmax())
        if rest < LEAST_REST:
            faults.append(
                f"{where}: {rest} samples are marked 'rest', at least {LEAST_REST} are needed to take out offset and drift"
            )
        elif moved != swept:
            turns = f"servo {SERVOS[moved]} moves {travel[moved]:.2f} rad, {SERVOS[swept]} {travel[swept]:.2f} rad"
            faults.append(f"{where}: {turns}; {_HINT}")
        elif len(np.unique(sweep.point[flexed])) >= 3:
            found = _judged_joints(corrected, flexed, swept, base)
            faults += found[0]
            remarks += found[1]
    if faults:
        told = list(dict.fromkeys(faults))
        more = f"; and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
        raise RecordError(f"the record is refused: {'; '.join(told[:SHOWN])}{more}")
    return list(dict.fromkeys(remarks))


def point_medians(sweep: Sweep, rows: np.ndarray) -> tuple[Array, Array, Array]:
    """Medians of the joints at each sampling point, and how far each sample is off them.

    Args:
        sweep: the record.
        rows: samples at the sampling points of one phase of one segment.

    Returns:
        Servo angles (points, 6), medians (points, 15), deviations (samples, 15) [rad]; NaN where nothing was measured.
    """
    points, place = np.unique(sweep.point[rows], return_inverse=True)
    measured = sweep.joint_pos[rows]
    medians = np.full((len(points), len(JOINTS)), np.nan)
    for number in range(len(points)):
        seen = ~np.isnan(measured[place == number]).all(axis=0)
        medians[number, seen] = np.nanmedian(measured[place == number][:, seen], axis=0)
    return group_means(sweep.servo[rows], place)[0], medians, measured - medians[place]


def noise_of(deviations: Array) -> float:
    """Robust standard deviation of samples about their point's median, NaN left out [rad]."""
    seen = deviations[~np.isnan(deviations)]
    return max(1.4826 * float(np.median(np.abs(seen))), LEAST_NOISE) if seen.size else LEAST_NOISE


def _judged_joints(sweep: Sweep, rows: np.ndarray, swept: int, base: Hand) -> tuple[list[str], list[str]]:
    """Faults and remarks of the joints that a servo moves, from the sampling points of its flexion."""
    servo, medians, deviations = point_medians(sweep, rows)
    design = elastic_joints_from_servo(np.clip(servo, base.servo_min, base.servo_max), base)
    travel, wanted = _travel(medians), _travel(np.where(np.isnan(medians), np.nan, design))
    own, where, faults, remarks = joints_of_servo(swept), f"sweep of {SERVOS[swept]}", [], []
    movers = ", ".join(JOINTS[joint] for joint in np.flatnonzero(travel > 0.2) if joint not in own)
    for joint in own:
        if np.isnan(travel[joint]):
            continue
        noise, share = noise_of(deviations[:, joint]), travel[joint] / wanted[joint]
        garbage = (np.abs(deviations[:, joint]) > FAR * noise).sum() / (~np.isnan(deviations[:, joint])).sum()
        if noise > MOST_NOISE:
            faults.append(
                f"{where}: {JOINTS[joint]} is measured to {np.degrees(noise):.1f}°, {np.degrees(MOST_NOISE):.0f}° is needed"
            )
        elif garbage > MOST_GARBAGE:
            faults.append(
                f"{where}: {garbage:.0%} of the samples of {JOINTS[joint]} lie more than {np.degrees(FAR * noise):.1f}° from the "
                f"others of their point, {MOST_GARBAGE:.0%} may"
            )
        elif not LEAST_SHARE <= share <= MOST_SHARE:
            others = f", while {movers} move" if movers else ""
            faults.append(
                f"{where}: {JOINTS[joint]} turns {share:.2f} of what the design's does{others}; does it rest, or {_HINT}"
            )
    if faults:
        return faults, remarks
    root = JOINTS.index(SERVOS[swept])
    for joint in own:
        pair = medians[:, [root, joint]]
        pair = pair[~np.isnan(pair).any(axis=1)]
        if joint == root or not (_travel(pair) >= 0.1).all():
            continue
        from scipy import stats  # takes half a second to load

        ratio, wanted = max(float(stats.theilslopes(pair[:, 1], pair[:, 0]).slope), 1e-3), base.elastic_ratio[joint]
        turns = f"{JOINTS[joint]} turns {ratio:.3f} rad for each rad of {SERVOS[swept]}, the design's {wanted:.3f}"
        if abs(np.log(ratio / wanted)) > np.log1p(RATIO_TOLERANCE):
            faults.append(f"{where}: {turns} within {RATIO_TOLERANCE:.0%}; {_HINT[:-1]}, or is this another hand?")
        elif wanted < 1 < ratio and JOINTS[joint].endswith("_dip"):
            remarks.append(
                f"{turns}: exchanged labels of the two look like this, and so do radii that are off by some percent; "
                f"the record cannot tell which"
            )
    return faults, remarks


def _travel(medians: Array) -> Array:
    """Range over which each joint turns, its extreme points left out, shape (joints,) [rad]; NaN for fewer than three points."""
    seen = [column[~np.isnan(column)] for column in medians.T]
    return np.array([np.ptp(np.quantile(values, (0.05, 0.95))) if values.size >= 3 else np.nan for values in seen])
