"""Accuracy of the written hand file: its errors at points of a sweep, and what they promise for
commands.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpac_gym.calibration.identification import Identification
from hpac_gym.calibration.record import Sweep
from hpac_gym.calibration.samples import DigitSamples, digit_samples, held_out_rows
from hpac_gym.figures import label
from hpac_gym.model import JOINT_INDEX, JOINTS, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import EXTENSION, FLEXION, settled_joints_from_servo

WORST_OF_JOINTS = 1.7
"""Error of the worst joint relative to the root mean square over the joints, in the median hand."""
BOUND = 2.2
"""Bound of the worst joint's error with 95 % confidence, relative to the expected one: the errors of
the two sweeps' cameras and warm-ups may cancel by chance.

Both were chosen on simulated hands with everything missing from the model at once, and judged on
others (`experiments.imperfect`)."""
CHECK_DOUBT_DEG = 1.5
"""Error in the second sweep above which the two sweeps contradict each other [°], chosen: those hands
reach 1.2°.
"""


@dataclass(frozen=True, slots=True)
class FileError:
    """Error of the written file for one joint, at the held-out points."""

    mean_abs_deg: float
    max_deg: float
    noise_deg: float
    """Standard deviation of one camera sample."""
    points: int


def residuals(
    by_servo: Mapping[int, DigitSamples], hand: Hand
) -> dict[str, tuple[DigitSamples, Array]]:
    """Measured minus predicted angles by joint: the digit's samples and the residuals (k,) [rad].

    Args:
        by_servo: the samples of every swept servo, by its index.
        hand: the hand that predicts.
    """
    table: dict[str, tuple[DigitSamples, Array]] = {}
    for column, samples in by_servo.items():
        servo = np.zeros((len(samples.servo), len(SERVOS)))
        servo[:, column] = samples.servo
        flexed = settled_joints_from_servo(servo, hand, FLEXION)
        extended = settled_joints_from_servo(servo, hand, EXTENSION)
        predicted = np.where(samples.direction[:, None] == FLEXION, flexed, extended)
        for i, joint in enumerate(samples.joints):
            if joint not in samples.missing:
                rest = samples.joint_pos[:, i] - predicted[:, JOINT_INDEX[joint]]
                table[joint] = samples, rest
    return {name: table[name] for name in JOINTS if name in table}


def file_errors(identified: Identification, written: Hand) -> dict[str, FileError]:
    """Errors at the held-out points, by joint."""
    held_out = {
        servo: samples.only(held_out_rows(samples)) for servo, samples in identified.samples.items()
    }
    return _errors(held_out, written)


def check_errors(second: Sweep, written: Hand, base: Hand) -> dict[str, FileError]:
    """Errors at all the points of an independent sweep, by joint."""
    by_servo = {servo: digit_samples(second, servo, base) for servo in range(len(SERVOS))}
    return _errors({servo: samples for servo, samples in by_servo.items() if samples}, written)


def _errors(by_servo: Mapping[int, DigitSamples], written: Hand) -> dict[str, FileError]:
    """Errors by joint; joints without a measurement at these points are left out."""
    errors = {}
    for name, (samples, rest) in residuals(by_servo, written).items():
        off = np.degrees(np.abs(rest[~np.isnan(rest)]))
        if off.size:
            noise = np.degrees(samples.noise[samples.joints.index(name)])
            errors[name] = FileError(float(off.mean()), float(off.max()), float(noise), off.size)
    return errors


def expected_worst_deg(errors: Mapping[str, FileError]) -> float:
    """Expected error of commands at the worst joint, from the errors in a second sweep [°].

    The joint that is worst in one sweep is not in the next: the geometric mean of the largest error
    and of what the root mean square over the joints lets expect."""
    off = np.array([error.mean_abs_deg for error in errors.values()])
    return float(np.sqrt(off.max() * WORST_OF_JOINTS * np.sqrt((off**2).mean())))


def contradictions(errors: Mapping[str, FileError]) -> list[str]:
    """A remark if a second sweep contradicts the first, which the hand's own changes do not."""
    off = [label(name) for name, error in errors.items() if error.mean_abs_deg > CHECK_DOUBT_DEG]
    return [
        f"the two sweeps differ by more than {CHECK_DOUBT_DEG:g}° in {', '.join(off)}: in one of them the camera was not "
        "square, or a scale, a marker or a tendon's seat was another; look, and sweep again"
    ] * bool(off)
