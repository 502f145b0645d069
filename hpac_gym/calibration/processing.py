"""The paper's processing of a record: radians, zero-phase Butterworth, unwrapping, drift
correction; then points.

Here unwrapping precedes the filter, and mistaken markers are left out: a low-pass would smear both
over neighbouring samples. On a record without them this makes no difference."""

import numpy as np
import scipy  # whose parts are loaded when they are used

from hpac_gym.calibration.record import REST, RecordError, Sweep, joints_of_servo
from hpac_gym.errors import WorkspaceError
from hpac_gym.model import JOINTS, SERVOS
from hpac_gym.model.checks import Array

CUTOFF_HZ = 3.0
"""Cut-off of the low-pass [Hz]. A point is held for half a second; a much lower cut-off would mix
in the adjacent steps.
"""
MOST_MISSING = 0.2
"""Largest share of missing samples of a joint in a segment."""
LONGEST_GAP = 6
"""Longest gap between samples, in sampling periods."""
FAR = 6.0
"""Robust standard deviations beyond which a sample of a stationary joint is an outlier."""
NEIGHBOURS = 7
"""Number of samples in the running median from which a sample may deviate."""
LEAST_FAR = np.deg2rad(2.0)
"""Deviation from its neighbours that a sample may have in any record [rad]."""
LEAST_NOISE = np.deg2rad(0.02)
"""Lower bound of the assumed camera noise [rad]."""
USUAL_DRIFT = np.deg2rad(0.2)
"""Standard deviation of a camera's drift in the course of a segment [rad], chosen."""
MOST_DRIFT = np.deg2rad(1.0) / 60
LEAST_SHIFT = np.deg2rad(0.5)
"""A digit did not come back to its stops if its rests differ by more than a camera drifts, `MOST_DRIFT`
[rad/s], and by more than `LEAST_SHIFT` [rad]. Chosen: five standard deviations of a usual camera."""


def processed(sweep: Sweep) -> Sweep:
    """The record after the paper's processing, segment by segment.

    Dropped frames, missing measurements and samples far from their neighbours are interpolated
    linearly for the filter and removed again after it, so that only these samples are lost.

    Raises:
        RecordError: A segment is not sampled evenly, has too many missing samples, or is too short
            to filter.
        WorkspaceError: The cut-off is not below half of the sampling rate.
    """
    joint_pos = sweep.joint_pos.copy()
    for rows in sweep.segments():
        rate = sampling_rate(sweep[rows])
        frame = np.round((sweep.time[rows] - sweep.time[rows[0]]) * rate).astype(int)
        frames = np.arange(frame[-1] + 1)
        for joint in range(joint_pos.shape[1]):
            seen = ~np.isnan(joint_pos[rows, joint])
            if not seen.any():
                continue
            unwrapped = np.full(len(rows), np.nan)
            unwrapped[seen] = np.unwrap(joint_pos[rows[seen], joint])
            off = off_neighbours(unwrapped[seen])
            seen[seen] = off <= max(FAR * robust_deviation(off), LEAST_FAR)
            missing = 1 - seen.sum() / len(frames)
            if missing > MOST_MISSING:
                raise RecordError(
                    f"{missing:.0%} of the samples of {JOINTS[joint]} from {sweep.time[rows[0]]:g} s to "
                    f"{sweep.time[rows[-1]]:g} s are missing or far from the others, more than {MOST_MISSING:.0%}"
                )
            filtered = low_pass(np.interp(frames, frame[seen], unwrapped[seen]), rate, CUTOFF_HZ)
            joint_pos[rows, joint] = np.where(seen, filtered[frame], np.nan)
    return without_drift(sweep.with_joint_pos(joint_pos))


def off_neighbours(values: Array) -> Array:
    """Distance of each value, without NaN, from the running median, which a steady motion equals;
    mistaken markers are far from it.
    """
    seen = values[~np.isnan(values)]
    off: Array = np.abs(seen - scipy.ndimage.median_filter(seen, NEIGHBOURS, mode="nearest"))
    return off


def sampling_rate(segment: Sweep) -> float:
    """Rate of a segment's evenly spaced samples [Hz], some of which may be missing.

    Raises:
        RecordError: A gap deviates from a multiple of the median gap by more than 5 % of it, or
            exceeds `LONGEST_GAP` of them.
    """
    time = segment.time
    gaps = np.diff(time)
    period = float(np.median(gaps)) if gaps.size else 0.0
    steps = np.maximum(np.round(gaps / period), 1) if period > 0 else gaps
    if (
        period <= 0
        or np.abs(gaps - steps * period).max() > 0.05 * period
        or steps.max() > LONGEST_GAP
    ):
        raise RecordError(
            f"trial {segment.trial[0]}, sweep of {SERVOS[segment.swept[0]]}: samples from {time[0]:g} s to {time[-1]:g} s "
            f"are not evenly spaced with at most {LONGEST_GAP - 1} dropped in a row; a filter needs them so"
        )
    return 1.0 / period


def low_pass(values: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Zero-phase second-order Butterworth low-pass of values of shape (n, ...), run forwards and
    backwards.

    Raises:
        WorkspaceError: The cut-off is not between 0 and half of the sampling rate.
        RecordError: Fewer samples than the filter needs at its ends.
    """
    if not 0 < cutoff_hz < rate_hz / 2:
        raise WorkspaceError(f"cut-off = {cutoff_hz} Hz must lie between 0 and {rate_hz / 2:g} Hz")
    sections = scipy.signal.butter(2, cutoff_hz, fs=rate_hz, output="sos")
    pad = int(np.ceil(rate_hz / cutoff_hz))
    if len(values) <= pad:
        raise RecordError(
            f"a segment of {len(values)} samples is too short: the filter needs more than {pad}"
        )
    filtered: Array = scipy.signal.sosfiltfilt(sections, values, axis=0, padlen=pad)
    return filtered


def differing_rests(segment: Sweep) -> dict[str, float]:
    """Swept joints whose last rest differs from the first by more than a camera drifts, and by how
    much [rad].
    """
    moving = np.flatnonzero(segment.phase != REST)
    rest = np.flatnonzero(segment.phase == REST)
    most = max(MOST_DRIFT * np.ptp(segment.time), LEAST_SHIFT)
    shifts = {}
    for joint in joints_of_servo(int(segment.swept[0])) if moving.size else ():
        rests = (rest[rest < moving[0]], rest[rest > moving[-1]])
        first, last = (segment.joint_pos[rows, joint] for rows in rests)
        if np.isfinite(first).any() and np.isfinite(last).any():
            shift = float(np.nanmedian(last) - np.nanmedian(first))
            if abs(shift) > most:
                shifts[JOINTS[joint]] = shift
    return shifts


def without_drift(sweep: Sweep) -> Sweep:
    """Subtract the camera's drift: a straight line in time through the readings of the swept joints
    at rest.

    Uses only the rest poses of a segment, where the swept joints are at zero, without outliers. If
    a joint is seen at rest at one end only, or the last rest is one of `differing_rests` and does not
    count, the drift is a constant; without rest it is left unchanged."""
    joint_pos = sweep.joint_pos.copy()
    for rows in sweep.segments():
        rest = rows[sweep.phase[rows] == REST]
        if not rest.size:
            continue
        moving = rows[sweep.phase[rows] != REST]
        ends = [rest]
        if moving.size and rest[0] < moving[0] and rest[-1] > moving[-1]:
            ends = [rest[rest < moving[0]], rest[rest > moving[0]]]
            ends = ends[: 1 if differing_rests(sweep[rows]) else 2]
        time = sweep.time - sweep.time[rows[0]]
        for joint in joints_of_servo(int(sweep.swept[rows[0]])):
            seen_at = [end[near_median(joint_pos[end, joint])] for end in ends]
            seen = np.concatenate(seen_at)
            if seen.size:
                basis = np.vander(time[seen], sum(end.size > 0 for end in seen_at))
                line = np.linalg.lstsq(basis, joint_pos[seen, joint], rcond=None)[0]
                joint_pos[rows, joint] -= np.polyval(line, time[rows])
    return sweep.with_joint_pos(joint_pos)


def near_median(values: Array) -> np.ndarray:
    """Mask of the samples of a joint at rest within `FAR` robust standard deviations of their
    median; False for NaN.
    """
    seen = values[~np.isnan(values)]
    off = values - np.median(seen) if seen.size else values
    return np.abs(off) <= FAR * noise_of(off)


def robust_deviation(values: Array) -> float:
    """Standard deviation of normal values about zero from their median magnitude, without NaN;
    outliers hardly change it.
    """
    seen = values[~np.isnan(values)]
    return 1.4826 * float(np.median(np.abs(seen))) if seen.size else 0.0


def noise_of(deviations: Array) -> float:
    """Robust standard deviation of samples about their point's median [rad], at least
    `LEAST_NOISE`.
    """
    return max(robust_deviation(deviations), float(LEAST_NOISE))


def points(sweep: Sweep) -> Sweep:
    """One entry for every sampling point of every segment and direction: the means of its samples."""
    held = (sweep.point >= 0) & (sweep.phase != REST)
    keys = np.stack([sweep.trial, sweep.swept, sweep.phase, sweep.point], axis=1)[held]
    labels, group = np.unique(keys, axis=0, return_inverse=True)
    time, servo, joint_pos = (
        group_means(values[held], group.reshape(-1))[0]
        for values in (sweep.time[:, None], sweep.servo, sweep.joint_pos)
    )
    trial, swept, phase, point = labels.T
    return Sweep(trial, swept, phase, point, time[:, 0], servo, joint_pos)


def group_means(values: Array, group: np.ndarray) -> tuple[Array, Array]:
    """Means and counts, shape (groups, m), of values (n, m) by their group's number (n,), ignoring
    NaN; NaN without values.
    """
    seen = ~np.isnan(values)
    total, count = np.zeros((2, group.max(initial=-1) + 1, values.shape[1]))
    np.add.at(total, group, np.where(seen, values, 0.0))
    np.add.at(count, group, seen)
    with np.errstate(invalid="ignore"):
        return total / count, count
