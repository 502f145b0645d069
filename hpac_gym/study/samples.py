"""What a record says about one digit, point by point: means of the samples that belong together, stops found, drift left open."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Hand, elastic_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import EXTENSION, FLEXION
from hpac_gym.study.judging import noise_of, point_medians
from hpac_gym.study.processing import FAR, LEAST_NOISE, without_drift
from hpac_gym.study.record import PHASES, Sweep

STOP_SLOPE = 0.3
"""A joint that turns by less than this share of its usual rate, to the end of the sweep, rests at a stop."""
BEFORE_STOP = 0.7
"""The same for the last step before that, in which it met the stop."""
TURNED = 0.1
"""Share of the servo's range after a turn in which friction has not yet turned round everywhere."""


@dataclass(frozen=True, slots=True)
class DigitSamples:
    """Points of one servo's sweeps, each the mean of its samples."""

    servo: Array
    """Commanded angle, shape (k,) [rad]."""
    direction: Array
    """`FLEXION` or `EXTENSION`, shape (k,)."""
    point: np.ndarray
    """Number of the sampling point, shape (k,)."""
    joint_pos: Array
    """Mean of the samples without those that lie far from the others, drift taken out, shape (k, joints) [rad]; NaN: none."""
    deviation: Array
    """Standard deviation of that mean as the samples' own scatter tells it, shape (k, joints) [rad]."""
    line: Array
    """What the rest poses leave open of the drift, for unit noise of a sample: offset and slope, shape (k, 2)."""
    noise: Array
    """Of one sample, by joint [rad]."""
    samples: int
    outliers: int
    """Samples that lie far from the others of their point."""
    missing: tuple[str, ...]
    """Joints without a measurement."""
    stops: dict[str, float]
    """Where joints were found to rest at a stop [rad]; the points from there on are left out."""
    at_stops: int
    """Points that are left out for it."""

    def only(self, rows: np.ndarray) -> DigitSamples:
        """The same with some of the points."""
        names = ("servo", "direction", "point", "joint_pos", "deviation", "line")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


def digit_samples(record: Sweep, servo: int, joints: tuple[str, ...], base: Hand = HPAC) -> DigitSamples | None:
    """The points of a servo's sweeps, none if none of the joints is measured in them."""
    corrected = without_drift(record)
    columns = [JOINT_INDEX[name] for name in joints]
    parts = []
    for rows in record.segments():
        if record.swept[rows[0]] != servo:
            continue
        for phase, direction in (("flexion", FLEXION), ("extension", EXTENSION)):
            held = rows[(record.phase[rows] == PHASES.index(phase)) & (record.point[rows] >= 0)]
            if held.size:
                parts.append(_phase_points(corrected, rows, held, columns, direction))
    seen = [bool(parts) and any((~np.isnan(part.joint_pos[:, i])).any() for part in parts) for i in range(len(joints))]
    if not any(seen):
        return None
    missing = tuple(name for name, any_seen in zip(joints, seen, strict=True) if not any_seen)
    noise = np.nanmean([part.noise for part in parts], axis=0)
    whole = DigitSamples(
        *(np.concatenate([getattr(part, name) for part in parts])
          for name in ("servo", "direction", "point", "joint_pos", "deviation", "line")),
        noise, sum(part.samples for part in parts), sum(part.outliers for part in parts), missing, {}, 0,
    )  # fmt: skip
    return _without_turns(_without_stops(whole, servo, joints, base), base.servo_max[servo] - base.servo_min[servo])


def _phase_points(sweep: Sweep, segment: np.ndarray, rows: np.ndarray, columns: list[int], direction: float) -> DigitSamples:
    numbers, place = np.unique(sweep.point[rows], return_inverse=True)
    count = len(numbers)
    mean, deviation = np.full((count, len(columns)), np.nan), np.full((count, len(columns)), np.nan)
    noise, samples, outliers = np.full(len(columns), np.nan), 0, 0
    for i, joint in enumerate(columns):
        _, _, off = point_medians(sweep, rows, joint)
        far = FAR * noise_of(off)
        near = np.abs(off) <= far  # False where NaN
        samples += int((~np.isnan(off)).sum())
        outliers += int((np.abs(off) > far).sum())
        values, kept = sweep.joint_pos[rows[near], joint], np.bincount(place[near], minlength=count)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean[:, i] = np.bincount(place[near], weights=values, minlength=count) / kept
            freedom = max(kept.sum() - (kept > 0).sum(), 1)
            noise[i] = max(np.sqrt(((values - mean[place[near], i]) ** 2).sum() / freedom), LEAST_NOISE)
            deviation[:, i] = noise[i] / np.sqrt(kept)
        mean[kept == 0, i] = deviation[kept == 0, i] = np.nan
    time = np.bincount(place, weights=sweep.time[rows]) / np.bincount(place)
    angle = np.bincount(place, weights=sweep.servo[rows, sweep.swept[rows[0]]]) / np.bincount(place)
    line = _open_line(sweep, segment, time)
    return DigitSamples(angle, np.full(count, direction), numbers, mean, deviation, line, noise, samples, outliers, (), {}, 0)


def _open_line(sweep: Sweep, segment: np.ndarray, time: Array) -> Array:
    """What the rest poses leave open of a segment's drift line at given times, shape (k, 2): offset and slope, decorrelated."""
    line = np.zeros((len(time), 2))
    rest = segment[sweep.phase[segment] == PHASES.index("rest")]
    if rest.size < 2:
        return line
    origin = sweep.time[rest].mean()
    line[:, 0] = 1 / np.sqrt(rest.size)
    if sweep.time[rest[-1]] > time.max():
        line[:, 1] = (time - origin) / np.sqrt(((sweep.time[rest] - origin) ** 2).sum())
    return line


def _without_stops(samples: DigitSamples, servo: int, joints: tuple[str, ...], base: Hand) -> DigitSamples:
    """Leave out the points at which a joint of the digit rests at a stop: beyond them the digit is another mechanism."""
    rows = np.flatnonzero(samples.direction == FLEXION)
    rows = rows[np.argsort(samples.servo[rows], kind="stable")]
    angles, first = np.unique(np.round(samples.servo[rows], 6), return_index=True)
    if len(angles) < 5:
        return samples
    command = np.zeros((len(angles), len(SERVOS)))
    command[:, servo] = np.clip(angles, base.servo_min[servo], base.servo_max[servo])
    design = elastic_joints_from_servo(command, base)
    found, starts, limit = {}, {}, np.inf
    for i, name in enumerate(joints):
        if name in samples.missing:
            continue
        course = np.array([np.nanmean(part) for part in np.split(samples.joint_pos[rows, i], first[1:])])
        rate = np.diff(course) / np.diff(design[:, JOINTS.index(name)])
        usual = np.nanmedian(rate)
        resting = rate < STOP_SLOPE * usual
        start = len(rate)
        while start > 0 and resting[start - 1]:
            start -= 1
        if start < len(rate):
            found[name], starts[name] = float(np.nanmean(course[start:])), start
        if start > 0 and rate[start - 1] < BEFORE_STOP * usual:
            start -= 1  # the step in which it met the stop, or might have
        if start < len(rate):
            limit = min(limit, angles[start])
    kept = samples.servo <= limit + 1e-6
    stops = {name: found[name] for name, start in starts.items() if start == min(starts.values())}  # the others are held by it
    return replace(samples.only(np.flatnonzero(kept)), stops=stops, at_stops=int((~kept).sum()))


def _without_turns(samples: DigitSamples, span: float) -> DigitSamples:
    """Leave out the points of the way back that lie too near to the turn."""
    back = samples.direction == EXTENSION
    if not back.any():
        return samples
    return samples.only(np.flatnonzero(~back | (samples.servo < samples.servo.max() - TURNED * span)))
