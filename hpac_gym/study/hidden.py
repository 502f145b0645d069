"""`hpac calibrate` on hidden hands: how far the file that it writes is off the truth, and how often its intervals hold it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hpac_gym.model import HPAC, JOINT_INDEX, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.files import hand_from_toml, hand_to_toml
from hpac_gym.model.parameters import Friction
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.progress import progress
from hpac_gym.study.bench import JointCamera, Protocol, metal_course, metal_sweeps
from hpac_gym.study.combinations import SweptDigit, combinations, values
from hpac_gym.study.identification import Identification, IdentificationError, identify
from hpac_gym.study.judging import judged
from hpac_gym.study.population import Built
from hpac_gym.study.quasistatic import Metal
from hpac_gym.study.record import RecordError, Sweep
from hpac_gym.study.rig import Rig, settings_of

GEOMETRY = ("d1", "d2", "alpha", "servo_radius", "joint_radius", "path_length")
STIFFNESS = ("spring_stiffness", "tendon_stiffness", "drive_stiffness")
CAMERA = JointCamera(outliers=0.02)
NOISE_MARK, ERROR_MARK_DEG = 1.3, 0.1
"""The marks of a good file: a mean error below 1.3 times the noise of a camera sample, or below 0.1°."""
DROPPED = 0.02
"""Share of the frames that the records lack."""
TRUTH_POINTS = 41

LAWS = {
    "laws of the fit": Metal(servo_stiffness=20.0, joint_friction=1e-3, tendon_friction=0.03, dead_band=5e-4),
    "other laws": Metal(
        first_segment=1.0, servo_stiffness=20.0, joint_friction=1e-3, cable_friction=0.05, guide_radius=0.5e-3, dead_band=1e-3
    ),
}
"""Hidden hands in metal whose physics is that of the fit, and whose physics is not: EA/L in both segments, a return cable that
loses tension at every joint, guide pins of 1 mm."""


def hidden_hands(count: int, seed: int, metal: Metal, stops: bool = True) -> list[Built]:
    """Hands drawn evenly: ±20 % on stiffnesses, ±5 % on geometry; zeros of 0.5°, frictions and servos to a factor of 1.5.

    Args:
        count: hands; hand i of a seed is the same for any count.
        seed: of the draw.
        metal: the middle of what the model leaves out.
        stops: joints stop at Table I's bounds.
    """
    built = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        digits, metals = {}, []
        for name, digit in HPAC.digits.items():
            changed = {}
            for field in (*GEOMETRY, *STIFFNESS):
                value, reach = getattr(digit, field), 0.2 if field in STIFFNESS else 0.05
                factor = 1 + rng.uniform(-reach, reach, np.shape(value))
                changed[field] = tuple((factor * value).tolist()) if isinstance(value, tuple) else float(factor * value)
            digits[name] = replace(digit, **changed)
            scale = np.exp(rng.normal(0.0, np.log(1.5), 4))
            metals.append(replace(
                metal,
                servo_zero=np.deg2rad(0.5) * rng.standard_normal(),
                servo_stiffness=metal.servo_stiffness * scale[0],
                joint_friction=metal.joint_friction * scale[1],
                tendon_friction=metal.tendon_friction * scale[2],
                cable_friction=metal.cable_friction * scale[3],
                stop=tuple(HPAC.workspace[joint][1] for joint in digit.joints) if stops else (),
            ))  # fmt: skip
        built.append(Built(replace(HPAC, digits=digits), tuple(metals)))
    return built


def swept_digit(built: Built, column: int) -> SweptDigit:
    """The numbers that a perfect fit of a hand in metal would find for one of its digits.

    Servo and driving tendon give way in series. The dead band stops a horn short in flexion, like a zero.
    """
    digit, metal = list(built.hand.digits.values())[column], built.metal[column]
    drive = 1 / (1 / digit.drive_stiffness + digit.servo_radius**2 / metal.servo_stiffness)
    friction = Friction(metal.joint_friction, metal.tendon_friction)
    return SweptDigit(replace(digit, drive_stiffness=drive), friction, metal.servo_zero - metal.dead_band)


def without_frames(record: Sweep, share: float, rng: np.random.Generator) -> Sweep:
    """The record without some of its frames."""
    return record[np.flatnonzero(rng.random(len(record)) >= share)]


@dataclass(frozen=True, slots=True)
class HiddenHand:
    """What calibration made of one hidden hand."""

    error_deg: Array
    """Mean absolute error of the written file against the truth where no joint is at a stop, by joint, NaN for the CMC [°]."""
    inside: dict[str, list[bool]]
    """Whether the intervals hold the truth, by combination, over the digits; empty where the laws have no such number."""
    told: dict[str, list[float]]
    stops_missed: int
    """Digits with a joint at its stop for two points or more, of which the report says nothing."""
    refused: str = ""


def calibrated(record: Sweep) -> tuple[Identification, Hand]:
    """What ``hpac calibrate`` does to a record: judged, fitted, written and read again.

    Raises:
        RecordError: The record cannot be of a hand of this design.
        IdentificationError: It supports no fit.
    """
    judged(record, HPAC)
    found = identify(record, hold_out=True)
    return found, hand_from_toml(hand_to_toml(found.hand), "the calibrated hand")


def judge_hand(built: Built, record: Sweep, truth: Array, servo: Array, know_truth: bool) -> HiddenHand:
    """Calibrate one hidden hand and compare with the truth.

    Args:
        built: the hand.
        record: its sweep.
        truth: where its joints really rest, shape (k, 15) [rad].
        servo: at these angles of all servos, shape (k, 6) [rad].
        know_truth: the hand obeys the laws of the fit, so that its combinations have true values.
    """
    try:
        found, written = calibrated(record)
    except (RecordError, IdentificationError) as error:
        return HiddenHand(np.full(15, np.nan), {}, {}, 0, str(error))
    predicted = settled_joints_from_servo(servo, written)
    errors, inside, told, missed = np.full(15, np.nan), {}, {}, 0
    for column, (name, digit) in enumerate(built.hand.digits.items()):
        joints = [JOINT_INDEX[joint] for joint in digit.joints]
        stop = np.array(built.metal[column].stop or [np.inf] * len(joints))
        free = (truth[:, joints] < stop - 1e-6).all(axis=1)
        errors[joints] = np.degrees(np.abs(predicted - truth)[np.ix_(free, joints)].mean(axis=0))
        if name not in found.fits:
            continue
        fit = found.fits[name]
        missed += int((~free).sum() * 31 / len(servo) >= 2 and not fit.samples.at_stops)
        if know_truth:
            for item, true in zip(fit.estimates, values(swept_digit(built, column)), strict=True):
                inside.setdefault(item.name, []).append(bool(item.low <= true <= item.high))
                told.setdefault(item.name, []).append(item.told)
    return HiddenHand(errors, inside, told, missed)


def run_hidden(count: int, seed: int, laws: str, shown: bool = False) -> list[HiddenHand]:
    """Calibrate hidden hands in metal."""
    built = hidden_hands(count, seed, LAWS[laws])
    records = metal_sweeps(built, seed, CAMERA, servos=SERVOS[:-1])
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, TRUTH_POINTS)
    truth = np.zeros((count, len(servo), 15))
    for column in range(len(HPAC.digits)):
        truth += metal_course(built, column, servo[:, column])
    return [
        judge_hand(
            built[i], without_frames(records[i], DROPPED, np.random.default_rng([seed, i, 9])), truth[i], servo, "fit" in laws
        )
        for i in progress(range(count), f"hidden hands, {laws}", shown)
    ]


@dataclass(frozen=True, slots=True)
class HiddenSummary:
    """All hidden hands of one kind."""

    hands: int
    refused: int
    median_deg: float
    """Over all joints and hands, of the written file's mean error."""
    worst_deg: float
    within: float
    """Share of the joints below 1.3 times the noise of a camera sample or below 0.1°."""
    coverage: dict[str, float]
    told: dict[str, float]
    stops_missed: int


def summarised(hands: Sequence[HiddenHand]) -> HiddenSummary:
    """Median, worst and coverage."""
    errors = np.concatenate([hand.error_deg for hand in hands])
    errors = errors[~np.isnan(errors)]
    names = [item.name for digit in ("index", "thumb") for item in combinations(HPAC.digits[digit])]
    mark = max(ERROR_MARK_DEG, NOISE_MARK * float(np.degrees(CAMERA.noise)))

    def pooled(what: str) -> dict[str, float]:
        table = {}
        for name in dict.fromkeys(names):
            hits = [x for hand in hands for x in getattr(hand, what).get(name, ())]
            if hits:
                table[name] = float(np.mean(hits))
        return table

    return HiddenSummary(
        len(hands),
        sum(bool(hand.refused) for hand in hands),
        float(np.median(errors)),
        float(errors.max()),
        float((errors <= mark).mean()),
        pooled("inside"),
        pooled("told"),
        sum(hand.stops_missed for hand in hands),
    )


def physics_hand(built: Built, seed: int, protocol: Protocol) -> tuple[Sweep, Sweep]:
    """A record of a hidden hand in the physics engine, and what a perfect camera would have seen of it."""
    metal = built.metal[0]
    settings = settings_of(metal.joint_friction, metal.dead_band, metal.tendon_friction)
    zero = (*(item.servo_zero for item in built.metal), 0.0)
    rig = Rig(built.hand, settings, JointCamera(noise=0.0, drift=0.0), protocol, servo_zero=zero)
    perfect = rig.sweep(np.random.default_rng(seed), servos=SERVOS[:-1])
    seen = perfect.joint_pos.copy()
    for rows in perfect.segments():
        seen[rows] = CAMERA.seen(seen[rows], perfect.time[rows], np.random.default_rng([seed, int(rows[0])]))
    return perfect.with_joint_pos(seen), perfect


def run_hidden_in_physics(count: int, seed: int, shown: bool = False) -> list[HiddenHand]:
    """Calibrate hidden hands of the physics engine: one friction for all digits, no servo compliance, Table I's stops.

    The truth is what a perfect camera saw of the same sweep at the sampling points.
    """
    hands = []
    middle = Metal(joint_friction=1e-3, tendon_friction=0.03, dead_band=5e-4)
    for number in progress(range(count), "hidden hands in the physics engine", shown):
        built = hidden_hands(number + 1, seed, middle)[number]
        first = built.metal[0]
        metal = tuple(
            replace(item, joint_friction=first.joint_friction, tendon_friction=first.tendon_friction) for item in built.metal
        )
        built = Built(built.hand, metal)
        record, perfect = physics_hand(built, seed + number, Protocol())
        flexed = (perfect.point >= 0) & (perfect.phase == 1)
        servo, truth = np.zeros((31, 6)), np.zeros((31, 15))
        for column in range(5):
            joints = [JOINT_INDEX[joint] for joint in list(HPAC.digits.values())[column].joints]
            for point in range(31):
                rows = np.flatnonzero(flexed & (perfect.swept == column) & (perfect.point == point))
                servo[point, column] = perfect.servo[rows, column].mean()
                truth[np.ix_([point], joints)] = perfect.joint_pos[np.ix_(rows, joints)].mean(axis=0)
        near = Built(built.hand, tuple(
            replace(item, stop=tuple(angle - np.deg2rad(0.3) for angle in item.stop)) for item in built.metal
        ))  # fmt: skip
        record = without_frames(record, DROPPED, np.random.default_rng([seed, number, 9]))
        hands.append(judge_hand(near, record, truth, servo, know_truth=True))
    return hands
