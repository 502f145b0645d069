"""The sampling points of one digit in a record: sample means, detected stops, and the uncertainty
of the drift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hpac_gym.calibration.judging import point_medians
from hpac_gym.calibration.processing import (
    FAR,
    LEAST_NOISE,
    USUAL_DRIFT,
    differing_rests,
    group_means,
    noise_of,
    without_drift,
)
from hpac_gym.calibration.record import EXTENDING, FLEXING, REST, Sweep, joints_of_servo
from hpac_gym.model import HPAC, JOINTS, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import EXTENSION, FLEXION
from hpac_gym.model.transmission import unchecked_synergy_from_servo

STOP_SLOPE = 0.3
"""A joint that turns by less than this share of its usual rate until the end of the sweep rests at
a stop.
"""
BEFORE_STOP = 0.9
"""The same share for the last step of a sweep, in which it may meet the stop; without one it turns
by 0.93 or more.
"""
TURNED = 0.1
"""Share of the servo's range after a reversal within which friction has not reversed everywhere."""
HELD_OUT_EVERY = 4
"""One in this many sampling points is held out for evaluation."""


@dataclass(frozen=True, slots=True)
class DigitSamples:
    """Sampling points of one servo's sweeps, each the mean of its samples."""

    joints: tuple[str, ...]
    """Joints that the servo moves, root first."""
    servo: Array
    """Commanded angle, shape (k,) [rad]."""
    direction: Array
    """`FLEXION` or `EXTENSION`, shape (k,)."""
    point: np.ndarray
    """Number of the sampling point, as if they were numbered one by one, shape (k,)."""
    joint_pos: Array
    """Mean of the samples without outliers, corrected for drift, shape (k, joints) [rad]; NaN
    without samples.
    """
    deviation: Array
    """Standard deviation of that mean from the scatter of the samples, shape (k, joints) [rad]."""
    line: Array
    """Uncertainty of the drift's offset and slope for unit noise of a sample, shape (k, 2 segments)."""
    noise: Array
    """Standard deviation of one sample, shape (joints,) [rad]."""
    samples: int
    outliers: int
    """Number of samples far from the others of their point."""
    missing: tuple[str, ...]
    """Joints without a measurement."""
    stops: dict[str, float]
    """Angles at which joints were found to rest at a stop [rad]; the points from there on are left
    out.
    """
    at_stops: int
    """Number of points left out because of stops."""

    def only(self, rows: np.ndarray) -> DigitSamples:
        """The samples restricted to some points."""
        return replace(self, **{name: getattr(self, name)[rows] for name in _OF_POINTS})


_OF_POINTS = ("servo", "direction", "point", "joint_pos", "deviation", "line")


def held_out_rows(samples: DigitSamples) -> np.ndarray:
    """Mask of the held-out points, shape (k,): every fourth sampling point, from number 2 on."""
    rows: np.ndarray = samples.point % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
    return rows


def digit_samples(record: Sweep, servo: int, base: Hand = HPAC) -> DigitSamples | None:
    """Sampling points of a servo's sweeps without those at stops or near the reversal; None if no
    joint was measured.
    """
    joints = joints_of_servo(servo)[::-1]
    parts = []
    segments = [rows for rows in record.segments() if record.swept[rows[0]] == servo]
    for place, rows in enumerate(segments):
        differing = differing_rests(record[rows])
        segment = without_drift(record[rows])
        for phase, direction in ((FLEXING, FLEXION), (EXTENDING, EXTENSION)):
            held = np.flatnonzero((segment.phase == phase) & (segment.point >= 0))
            if held.size:
                part = _phase_points(segment, held, joints, direction, bool(differing))
                others = 2 * place, 2 * (len(segments) - 1 - place)
                parts.append(replace(part, line=np.pad(part.line, ((0, 0), others))))
    if not parts:
        return None
    of_points: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts]) for name in _OF_POINTS
    }
    numbers, rank = np.unique(of_points["point"], return_inverse=True)
    of_points["point"] = numbers[0] + rank
    unseen = np.isnan(of_points["joint_pos"]).all(axis=0)
    if unseen.all():
        return None
    whole = replace(
        parts[0],
        **of_points,
        noise=np.mean([part.noise for part in parts], axis=0),
        samples=sum(part.samples for part in parts),
        outliers=sum(part.outliers for part in parts),
        missing=tuple(JOINTS[joint] for joint, never in zip(joints, unseen, strict=True) if never),
    )
    kept = _without_stops(whole, servo, base)
    back = kept.direction == EXTENSION
    near_turn = kept.servo >= kept.servo.max() - TURNED * (
        base.servo_max[servo] - base.servo_min[servo]
    )
    return kept.only(~(back & near_turn))


def _phase_points(
    sweep: Sweep, rows: np.ndarray, joints: list[int], direction: float, differing: bool
) -> DigitSamples:
    numbers, place = np.unique(sweep.point[rows], return_inverse=True)
    servo, _, deviations = point_medians(sweep, rows)
    off = np.abs(deviations[:, joints])
    far = FAR * np.array([noise_of(values) for values in off.T])
    values = np.where(off <= far, sweep.joint_pos[rows][:, joints], np.nan)
    mean, kept = group_means(values, place)
    freedom = np.maximum(kept.sum(axis=0) - (kept > 0).sum(axis=0), 1)
    noise = np.maximum(
        np.sqrt(np.nansum((values - mean[place]) ** 2, axis=0) / freedom), LEAST_NOISE
    )
    time = group_means(sweep.time[rows][:, None], place)[0][:, 0]
    return DigitSamples(
        tuple(JOINTS[joint] for joint in joints),
        servo[:, sweep.swept[rows[0]]],
        np.full(len(numbers), direction),
        numbers,
        mean,
        noise / np.sqrt(np.where(kept > 0, kept, np.nan)),
        _open_line(sweep, time, USUAL_DRIFT / noise.max() if differing else 0.0),
        noise,
        int((~np.isnan(off)).sum()),
        int((off > far).sum()),
        (),
        {},
        0,
    )


def _open_line(sweep: Sweep, time: Array, drift: float) -> Array:
    """Remaining uncertainty of a segment's drift line after the rest poses, shape (k, 2): offset
    and slope, decorrelated.

    Where the rests differ, the points tell the drift from the first to the last, as far as they can,
    about 0 and with a standard deviation of `drift` in units of the noise; otherwise it is 0.
    """
    line = np.zeros((len(time), 2))
    rest = sweep.time[sweep.phase == REST]
    if rest.size < 2:
        return line
    if drift:
        line[:, 0] = 1 / np.sqrt((rest < time.min()).sum())
        line[:, 1] = drift * (time - rest[0]) / np.ptp(rest)
    else:
        line[:, 0] = 1 / np.sqrt(rest.size)
        if rest[-1] > time.max():
            line[:, 1] = (time - rest.mean()) / np.sqrt(((rest - rest.mean()) ** 2).sum())
    return line


def _without_stops(samples: DigitSamples, servo: int, base: Hand) -> DigitSamples:
    """Leave out the points at which a joint of the digit rests at a stop, where the model does not
    apply.
    """
    rows = np.flatnonzero(samples.direction == FLEXION)
    rows = rows[np.argsort(samples.servo[rows], kind="stable")]
    angles, place = np.unique(np.round(samples.servo[rows], 6), return_inverse=True)
    if len(angles) < 5:
        return samples
    command = np.zeros((len(angles), len(SERVOS)))
    command[:, servo] = angles
    turns = np.diff(unchecked_synergy_from_servo(command, base)[:, servo])
    turns[turns <= 0] = np.nan  # past the guides, where the design says nothing
    met = {}
    limit = np.inf
    for name, course in zip(
        samples.joints, group_means(samples.joint_pos[rows], place)[0].T, strict=True
    ):
        rate = np.diff(course) / turns
        if np.isnan(rate).all():
            continue
        usual = np.nanmedian(rate)
        turning = np.flatnonzero(~(rate < STOP_SLOPE * usual))
        start = turning[-1] + 1 if turning.size else 0
        if start < len(rate):
            met[name] = start, float(np.nanmean(course[start:]))
        if start > 0 and (start < len(rate) or rate[-1] < BEFORE_STOP * usual):
            start -= 1  # it met the stop within the preceding step
        if start < len(rate):
            limit = min(limit, angles[start])
    kept = samples.servo <= limit + 1e-6
    first = min((start for start, _ in met.values()), default=0)  # it holds the others
    stops = {name: angle for name, (start, angle) in met.items() if start == first}
    return replace(samples.only(kept), stops=stops, at_stops=int((~kept).sum()))
