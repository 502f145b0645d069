"""`hpac calibrate` on hidden hands: error of the written file, and coverage of its intervals."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments.bench import JointCamera, metal_sweeps
from experiments.populations import (
    FIT_LAWS,
    FRICTION,
    OTHER_LAWS,
    SERVO,
    ZERO,
    geometry,
    varied_digit,
    varied_metal,
)
from experiments.quasistatic import Built, Metal, hand_course, softened
from experiments.results import Column, Part, rows_of, table
from experiments.rig import NEAR_STOP, rig_of
from hpac_gym.calibration.combinations import SweptDigit, combinations, values
from hpac_gym.calibration.fitting import IdentificationError
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import RecordError, Sweep
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Array, Friction
from hpac_gym.model.files import hand_from_toml, hand_to_toml
from hpac_gym.model.settled import settled_joints_from_servo
from hpac_gym.output import markdown
from hpac_gym.progress import progress

REACH = {
    **geometry(0.05),
    "path_length": 0.05,
    "spring_stiffness": 0.2,
    "tendon_stiffness": 0.2,
    "drive_stiffness": 0.2,
}
"""Hidden hands are drawn uniformly within these relative deviations from the nominal parameters."""
DEAD_BAND = 5e-4
LAWS = {"laws of the fit": replace(FIT_LAWS, dead_band=DEAD_BAND), "other laws": OTHER_LAWS}
"""Physics of the hidden hands: that of the fit, and another."""
CAMERA = JointCamera(outliers=0.02)
MARK_DEG = max(0.1, 1.3 * float(np.degrees(CAMERA.noise)))
"""Threshold of a good file's mean error: 1.3 times the noise of a camera sample, or 0.1° [°]."""
DROPPED = 0.02
"""Share of frames missing from the records."""


def hidden_hands(count: int, seed: int, metal: Metal) -> list[Built]:
    """Random hands close to the nominal one, with Table I's stops; zeros of 0.5°, frictions and
    servos to a factor of 1.5.

    Args:
        count: number of hands; hand i of a seed is the same for any count.
        seed: seed of the draw.
        metal: median of the effects that the model omits.
    """
    built = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        digits = {}
        metals = []
        for name, digit in HPAC.digits.items():
            digits[name] = varied_digit(digit, REACH, partial(rng.uniform, -1.0, 1.0))
            factors = np.exp(rng.normal(0.0, np.log(1.5), 4))
            stopped = replace(metal, stop=tuple(HPAC.workspace[joint][1] for joint in digit.joints))
            metals.append(varied_metal(stopped, ZERO * rng.standard_normal(), factors))
        built.append(Built(replace(HPAC, digits=digits), tuple(metals)))
    return built


def swept_digit(built: Built, column: int) -> SweptDigit:
    """The parameters that a perfect fit of a hand in metal would find for one of its digits.

    The compliances of servo and driving tendon add up. In flexion the dead band stops the horn
    short, like a zero."""
    digit = list(built.hand.digits.values())[column]
    metal = built.metal[column]
    friction = Friction(metal.joint_friction, metal.tendon_friction)
    return SweptDigit(
        replace(digit, drive_stiffness=softened(digit, metal)),
        friction,
        metal.servo_zero - metal.dead_band,
    )


@dataclass(frozen=True, slots=True)
class HiddenHand:
    """Result of the calibration of one hidden hand."""

    error_deg: Array
    """Mean absolute error of the written file, where no joint is at a stop, by joint; NaN for the
    CMC [°].
    """
    estimates: Sequence[tuple[str, bool, float]]
    """Each combination of each digit: its name, whether its interval contains the truth, and the
    share that the data tell; empty if the laws have no such number.
    """
    stops_missed: int
    """Number of digits with a joint at its stop for two points or more that the report does not
    mention.
    """
    refused: bool = False


def judge_hand(
    built: Built, record: Sweep, truth: Array, servo: Array, know_truth: bool
) -> HiddenHand:
    """Check and fit a hidden hand's record, write the file as ``hpac calibrate`` does, and compare
    it with the truth.

    Args:
        built: the hand.
        record: its sweep.
        truth: true joint angles, shape (k, 15) [rad].
        servo: servo angles of `truth`, shape (k, 6) [rad].
        know_truth: the hand obeys the laws of the fit, so that its combinations have true values.
    """
    errors = np.full(len(JOINTS), np.nan)
    try:
        judged(record, HPAC)
        identified = identify(record, hold_out=True)
        written = hand_from_toml(hand_to_toml(identified.hand), "the calibrated hand")
    except (RecordError, IdentificationError):
        return HiddenHand(errors, (), 0, refused=True)
    off = np.degrees(np.abs(settled_joints_from_servo(servo, written) - truth))
    estimates = []
    missed = 0
    for column, (name, digit) in enumerate(built.hand.digits.items()):
        joints = [JOINT_INDEX[joint] for joint in digit.joints]
        free = (truth[:, joints] < np.array(built.metal[column].stop) - 1e-6).all(axis=1)
        errors[joints] = off[np.ix_(free, joints)].mean(axis=0)
        if name not in identified.fits:
            continue
        fit = identified.fits[name]
        missed += int((~free).sum() * 31 / len(servo) >= 2 and not fit.samples.at_stops)
        if know_truth:
            for item, true in zip(fit.estimates, values(swept_digit(built, column)), strict=True):
                inside = bool(item.low <= true <= item.high)
                estimates.append((item.name, inside, item.told))
    return HiddenHand(errors, estimates, missed)


def without_frames(record: Sweep, seed: int, number: int) -> Sweep:
    """The record of a hand with randomly dropped frames."""
    rng = np.random.default_rng([seed, number, 9])
    return record[np.flatnonzero(rng.random(len(record)) >= DROPPED)]


def run_hidden(count: int, seed: int, laws: str) -> list[HiddenHand]:
    """Calibrate hidden hands in metal that obey one of the `LAWS`."""
    built = hidden_hands(count, seed, LAWS[laws])
    records = metal_sweeps(built, seed, CAMERA, servos=SERVOS[:-1])
    truth = hand_course(built, SERVO, 2)
    return [
        judge_hand(
            built[i],
            without_frames(records[i], seed, i),
            truth[i],
            SERVO,
            laws == "laws of the fit",
        )
        for i in progress(range(count), f"hidden hands, {laws}")
    ]


def measured_in_physics(count: int, seed: int) -> Iterator[tuple[Built, Sweep, Array, Array]]:
    """Hidden hands of the physics engine, their records, and servo and true joint angles at the
    sampling points.
    """
    hidden = enumerate(hidden_hands(count, seed, replace(FRICTION, dead_band=DEAD_BAND)))
    for number, built in progress(list(hidden), "hidden hands in the physics engine"):
        record, servo, truth = rig_of(built).seen_and_true(CAMERA, seed + number)
        yield built, without_frames(record, seed, number), servo, truth


def run_hidden_in_physics(count: int, seed: int) -> list[HiddenHand]:
    """Calibrate hidden hands of the physics engine: one friction for all digits, no servo
    compliance, Table I's stops.

    The truth is the measurement of a perfect camera at the sampling points of the same sweep.
    """
    hands = []
    for built, record, servo, truth in measured_in_physics(count, seed):
        friction = {
            name: getattr(built.metal[0], name) for name in ("joint_friction", "tendon_friction")
        }
        metal = tuple(
            replace(item, **friction, stop=tuple(angle - NEAR_STOP for angle in item.stop))
            for item in built.metal
        )
        hands.append(judge_hand(Built(built.hand, metal), record, truth, servo, know_truth=True))
    return hands


def _errors(hands: Sequence[HiddenHand]) -> Array:
    errors = np.concatenate([hand.error_deg for hand in hands])
    return errors[~np.isnan(errors)]


def _pooled(hands: Sequence[HiddenHand], place: int) -> dict[str, float]:
    """Means of one entry of the estimates by combination, over hands and digits."""
    pooled: dict[str, list[float]] = {
        item.name: [] for digit in ("index", "thumb") for item in combinations(HPAC.digits[digit])
    }
    for estimate in (estimate for hand in hands for estimate in hand.estimates):
        pooled[estimate[0]].append(estimate[place])
    return {name: float(np.mean(values)) for name, values in pooled.items() if values}


COLUMNS = (
    Column("hands", "hands", len),
    Column("refused", "refused", lambda hands: sum(hand.refused for hand in hands)),
    Column(
        "median_deg",
        "file's error, median [°]",
        lambda hands: float(np.median(_errors(hands))),
        "{:.3f}",
    ),
    Column("worst_deg", "worst joint", lambda hands: float(_errors(hands).max()), "{:.3f}"),
    Column(
        "within",
        "joints within the mark",
        lambda hands: float((_errors(hands) <= MARK_DEG).mean()),
        "{:.1%}",
    ),
    Column("stops_missed", "stops missed", lambda hands: sum(hand.stops_missed for hand in hands)),
)
COVERAGE = (
    Column("coverage", "", lambda hands: _pooled(hands, 1)),
    Column("told", "", lambda hands: _pooled(hands, 2)),
)
"""Coverage of the intervals, which has a separate table in the report."""


def calibration(count: int, seed: int, in_physics: int = 0) -> Part:
    """`hpac calibrate` on hidden hands of every kind: `count` of each law in metal, `in_physics` in
    the physics engine.
    """
    hands = {laws: run_hidden(count, seed, laws) for laws in LAWS}
    if in_physics:
        hands["physics engine"] = run_hidden_in_physics(in_physics, seed)
    rows = rows_of((*COLUMNS, *COVERAGE), hands)
    fit = rows["laws of the fit"]
    body = [
        (name, f"{share:.0%}", f"{fit['told'][name]:.0%}")
        for name, share in fit["coverage"].items()
    ]
    head = ("combination", "95 % interval contains the truth", "determined by the data")
    parts = [
        f"## `hpac calibrate` on hidden hands, seed {seed}",
        table("hidden", COLUMNS, rows),
        markdown(head, body),
    ]
    if in_physics:
        share = np.mean(list(rows["physics engine"]["coverage"].values()))
        parts.append(f"In the physics engine {share:.0%} of the intervals hold the truth.")
    return Part("\n\n".join(parts) + "\n", rows)
