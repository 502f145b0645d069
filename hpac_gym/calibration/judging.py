"""Plausibility checks of a record, which `hpac sweep` and `hpac calibrate` make first."""

import warnings

import numpy as np
import scipy  # whose parts are loaded when they are used

from hpac_gym.calibration.processing import (
    FAR,
    differing_rests,
    group_means,
    noise_of,
    off_neighbours,
    without_drift,
)
from hpac_gym.calibration.record import (
    EXTENDING,
    FLEXING,
    REST,
    RecordError,
    Sweep,
    joints_of_servo,
)
from hpac_gym.model import JOINTS, SERVOS, Hand, elastic_joints_from_servo
from hpac_gym.model.checks import Array

LEAST_REST = 5
"""Least number of samples at rest in a segment."""
LEAST_SHARE = 0.5
MOST_SHARE = 2.0
"""Bounds of a swept joint's travel relative to the design's."""
RATIO_TOLERANCE = 0.15
"""Tolerance of the ratio of a joint's angle to its root joint's, relative to the design: 5 % errors
in two radii give 0.11.
"""
MOST_GARBAGE = 0.1
"""Largest share of outliers among a joint's samples."""
MOST_NOISE = np.deg2rad(1.0)
"""Largest standard deviation of samples within a sampling point [rad]."""
CERTAIN = 4.0
"""Standard errors by which a joint must lag behind its root joint, or lead it, for the record to
tell which is which.
"""
STILL = np.deg2rad(0.5)
"""Motion of a servo within a sampling point [rad]; more is a servo column that belongs to other rows.
"""
OFF_COURSE = np.deg2rad(2.0)
"""Deviation of a point from the running median of its neighbours, which a steady course equals [rad].
"""
SHOWN = 3
"""Number of faults that the message lists."""
_HINT = "are labels exchanged?"


def judged(sweep: Sweep, base: Hand, name: str = "the record") -> list[str]:
    """Reject a record that cannot belong to a hand of this design; returns remarks on ambiguities.

    Args:
        sweep: the unfiltered record.
        base: the hand's design.
        name: name of the record in errors.

    Raises:
        RecordError: The record has no points; or a segment has no rest or is labelled with another
            servo, or one of its joints rests, moves with another servo, has another ratio, or is
            measured too inaccurately. The message has the first faults.
    """
    faults = []
    remarks = []
    if not ((sweep.phase == FLEXING) & (sweep.point >= 0)).any():
        raise RecordError(
            f"{name} is refused: column point: no row of a flexion is at a sampling point (all are −1)"
        )
    for rows in sweep.segments():
        segment = sweep[rows]
        flexed = np.flatnonzero((segment.phase == FLEXING) & (segment.point >= 0))
        if not flexed.size:
            continue
        swept = int(segment.swept[0])
        where = f"trial {segment.trial[0]}, sweep of {SERVOS[swept]}"
        rest = np.flatnonzero(segment.phase == REST)
        travel = np.ptp(segment.servo[flexed], axis=0)
        moved = int(travel.argmax())
        numbers = segment.point[flexed]
        low = base.servo_min[swept]
        high = base.servo_max[swept]
        points = [segment.servo[flexed[numbers == number], swept] for number in np.unique(numbers)]
        if rest.size < LEAST_REST:
            faults.append(
                f"{where}: {rest.size} samples are marked 'rest', at least {LEAST_REST} are needed to take out offset and drift"
            )
        elif moved != swept or travel[moved] == 0:
            instead = (
                f", but {SERVOS[moved]} {travel[moved]:.2f} rad; {_HINT}"
                if travel[moved] > 0
                else ""
            )
            faults.append(f"{where}: servo {SERVOS[swept]} moves {travel[swept]:.2f} rad{instead}")
        elif len(points) < 3:
            faults.append(
                f"{where}: column point numbers {len(points)} points while servo {SERVOS[swept]} moves "
                f"{travel[swept]:.2f} rad; each place where it stands needs a number of its own, at least 3"
            )
        elif (moves := max(np.ptp(angles) for angles in points)) > STILL:
            faults.append(
                f"{where}: servo {SERVOS[swept]} moves by up to {np.degrees(moves):.1f}° within a sampling point, at most "
                f"{np.degrees(STILL):.1f}° is accepted; does its column belong to other rows?"
            )
        elif not np.ptp(np.clip(segment.servo[flexed, swept], low, high)):
            faults.append(
                f"{where}: servo {SERVOS[swept]} moves from {points[0].mean():.2f} to {points[-1].mean():.2f} rad, outside of "
                f"the design's [{low:.2f}, {high:.2f}] rad; does its angle count the other way?"
            )
        else:
            differing = differing_rests(segment)
            if differing:
                most = np.degrees(max(map(abs, differing.values())))
                remarks.append(
                    f"{where}: the rests of {', '.join(differing)} differ by up to {most:.1f}°, more than "
                    "a camera drifts: did the digit not come back to its stops, or did the camera move? The first "
                    "rest counts, and a drift is fitted"
                )
            of_joints = _judged_joints(without_drift(segment), flexed, swept, base)
            faults += of_joints[0]
            remarks += of_joints[1]
            if not rest[0] < flexed[0] < flexed[-1] < rest[-1]:
                remarks.append(
                    f"{where}: rest poses at one end only: the camera's offset is taken out, its drift is not"
                )
    if faults:
        told = list(dict.fromkeys(faults))
        more = f"; and {len(told) - SHOWN} more" if len(told) > SHOWN else ""
        raise RecordError(f"{name} is refused: {'; '.join(told[:SHOWN])}{more}")
    return list(dict.fromkeys(remarks))


def point_medians(sweep: Sweep, rows: np.ndarray) -> tuple[Array, Array, Array]:
    """Medians of the joints at each sampling point of one phase of one segment, and the deviation
    of its samples from them.

    Returns:
        Servo angles (points, 6), medians (points, 15), deviations (samples, 15) [rad]; NaN where
        nothing was measured.
    """
    numbers, place = np.unique(sweep.point[rows], return_inverse=True)
    measured = sweep.joint_pos[rows]
    with warnings.catch_warnings(action="ignore"):  # of points without a measurement
        medians = np.stack(
            [np.nanmedian(measured[place == i], axis=0) for i in range(len(numbers))]
        )
    return group_means(sweep.servo[rows], place)[0], medians, measured - medians[place]


def _judged_joints(
    segment: Sweep, flexed: np.ndarray, swept: int, base: Hand
) -> tuple[list[str], list[str]]:
    """Faults and remarks on the joints that a servo moves, from a segment and the rows of its
    flexion's points.
    """
    servo, medians, deviations = point_medians(segment, flexed)
    design = elastic_joints_from_servo(np.clip(servo, base.servo_min, base.servo_max), base)
    travel = _travel(medians)
    wanted = _travel(np.where(np.isnan(medians), np.nan, design))
    own = joints_of_servo(swept)
    where = f"sweep of {SERVOS[swept]}"
    faults: list[str] = []
    remarks: list[str] = []
    movers = ", ".join(JOINTS[joint] for joint in np.flatnonzero(travel > 0.2) if joint not in own)
    for joint in own:
        if np.isnan(travel[joint]):
            continue
        noise = noise_of(deviations[:, joint])
        share = np.copysign(travel[joint], np.nanmean(medians[:, joint])) / wanted[joint]
        garbage = (np.abs(deviations[:, joint]) > FAR * noise).sum() / (
            ~np.isnan(deviations[:, joint])
        ).sum()
        rests = (~np.isnan(segment.joint_pos[segment.phase == REST, joint])).sum()
        if rests < LEAST_REST:
            faults.append(
                f"{where}: {JOINTS[joint]} is measured in {rests} samples at rest, at least {LEAST_REST} are needed"
            )
        elif noise > MOST_NOISE:
            faults.append(
                f"{where}: {JOINTS[joint]} is measured to {np.degrees(noise):.1f}°, {np.degrees(MOST_NOISE):.0f}° is needed"
            )
        elif garbage > MOST_GARBAGE:
            faults.append(
                f"{where}: {garbage:.0%} of the samples of {JOINTS[joint]} lie more than {np.degrees(FAR * noise):.1f}° from the "
                f"others of their point, {MOST_GARBAGE:.0%} may"
            )
        elif not LEAST_SHARE <= share <= MOST_SHARE:
            others = f", but {movers} moved" if movers else ""
            faults.append(
                f"{where}: {JOINTS[joint]} turns {share:z.2f} of the design's travel{others}; "
                f"does it rest, or count the other way, or {_HINT}"
            )
    if faults:
        return faults, remarks
    root = JOINTS.index(SERVOS[swept])
    remarks += [
        f"{where}: points of {JOINTS[joint]} lie up to {np.degrees(off):.0f}° beside the course of the others; were markers "
        "exchanged for a while?"
        for joint in own
        if (off := off_neighbours(medians[:, joint]).max(initial=0.0)) > OFF_COURSE
    ]
    for joint in own:
        pair = medians[:, [root, joint]]
        pair = pair[~np.isnan(pair).any(axis=1)]
        if joint == root or not (_travel(pair) >= 0.1).all():
            continue
        ratio = max(float(scipy.stats.theilslopes(pair[:, 1], pair[:, 0]).slope), 1e-3)
        wanted = base.elastic_ratio[joint]
        turns = f"{JOINTS[joint]} turns {ratio:.3f} rad for each rad of {SERVOS[swept]}, by design {wanted:.3f}"
        lag, error = lag_behind(segment, root, joint)
        if abs(np.log(ratio / wanted)) > np.log1p(RATIO_TOLERANCE):
            faults.append(
                f"{where}: {turns} ± {RATIO_TOLERANCE:.0%}; {_HINT[:-1]}, or is this another hand?"
            )
        elif lag < -CERTAIN * error:
            faults.append(
                f"{where}: {SERVOS[swept]}, which the tendon pulls, lags behind {JOINTS[joint]} by {np.degrees(-lag):.2f} ± "
                f"{np.degrees(2 * error):.2f}° in both directions; {_HINT}"
            )
        elif wanted < 1 < ratio and not lag > CERTAIN * error:
            remarks.append(
                f"{turns}: exchanged labels of the two look like this, and so do radii that are off by some percent; "
                f"a record that also has frames of the digit's return tells which"
            )
    return faults, remarks


def lag_behind(segment: Sweep, root: int, joint: int) -> tuple[float, float]:
    """Lag of a joint behind its root joint, which friction and inertia cause in both directions,
    and its standard error [rad].

    The driving tendon pulls on the root joint and the others follow: at the same angle of the root
    they are less flexed in flexion than in extension, whatever the radii. Uses the frames in
    motion, because a digit that stops overshoots within its friction band, or those of the points
    where no others are recorded. Infinite error if the record has one direction only."""
    seen = segment[
        (segment.phase != REST) & ~np.isnan(segment.joint_pos[:, [root, joint]]).any(axis=1)
    ]
    moving = seen[seen.point < 0]
    seen = moving if {FLEXING, EXTENDING} <= set(moving.phase) else seen
    angle, other = seen.joint_pos[:, [root, joint]].T
    low, high = np.quantile(angle, (0.05, 0.95))
    inside = np.abs(angle - (low + high) / 2) < 0.4 * (high - low)
    direction = np.where(seen.phase == EXTENDING, 1.0, -1.0)[inside]
    angle = angle[inside]
    other = other[inside]
    if abs(direction.sum()) == len(direction):
        return 0.0, np.inf
    basis = np.column_stack([np.vander(angle, 3), direction])
    kept = np.ones(len(angle), dtype=bool)
    for _ in range(5):  # without outliers
        off = other - basis @ np.linalg.lstsq(basis[kept], other[kept], rcond=None)[0]
        kept = np.abs(off) <= FAR * noise_of(off)
    solution = np.linalg.lstsq(basis[kept], other[kept], rcond=None)[0]
    error = noise_of(off) * np.sqrt(np.linalg.pinv(basis[kept].T @ basis[kept])[-1, -1])
    return float(solution[-1]), float(error)


def _travel(medians: Array) -> Array:
    """Travel of each joint without its extreme points, shape (joints,) [rad]; NaN for fewer than
    three points.
    """
    seen = [column[~np.isnan(column)] for column in medians.T]
    return np.array(
        [
            np.ptp(np.quantile(values, (0.05, 0.95))) if values.size >= 3 else np.nan
            for values in seen
        ]
    )
