"""`hpac calibrate` on hidden hands: error of the written file, coverage of its intervals, and
refusal of exchanged labels.
"""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments.bench import JointCamera, Protocol, metal_sweeps
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
from hpac_gym.calibration.record import EXTENDING, RecordError, Sweep, joints_of_servo
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS
from hpac_gym.model.calibration import Friction
from hpac_gym.model.checks import Array
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


# Calibrated and judged -----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class HiddenHand:
    """Result of the calibration of one hidden hand."""

    error_deg: Array
    """Mean absolute error of the written file, where no joint is at a stop, by joint; NaN for the
    CMC [°].
    """
    inside: Mapping[str, list[bool]]
    """Whether the intervals contain the truth, by combination, over the digits; empty if the laws
    have no such number.
    """
    told: Mapping[str, list[float]]
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
        found = identify(record, hold_out=True)
        written = hand_from_toml(hand_to_toml(found.hand), "the calibrated hand")
    except (RecordError, IdentificationError):
        return HiddenHand(errors, {}, {}, 0, refused=True)
    off = np.degrees(np.abs(settled_joints_from_servo(servo, written) - truth))
    inside = {}
    told = {}
    missed = 0
    for column, (name, digit) in enumerate(built.hand.digits.items()):
        joints = [JOINT_INDEX[joint] for joint in digit.joints]
        free = (truth[:, joints] < np.array(built.metal[column].stop) - 1e-6).all(axis=1)
        errors[joints] = off[np.ix_(free, joints)].mean(axis=0)
        if name not in found.fits:
            continue
        fit = found.fits[name]
        missed += int((~free).sum() * 31 / len(servo) >= 2 and not fit.samples.at_stops)
        if know_truth:
            for item, true in zip(fit.estimates, values(swept_digit(built, column)), strict=True):
                inside.setdefault(item.name, []).append(bool(item.low <= true <= item.high))
                told.setdefault(item.name, []).append(item.told)
    return HiddenHand(errors, inside, told, missed)


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


# All hands of one kind ------------------------------------------------------------------


def _errors(hands: Sequence[HiddenHand]) -> Array:
    errors = np.concatenate([hand.error_deg for hand in hands])
    return errors[~np.isnan(errors)]


def _pooled(tables: Sequence[Mapping[str, list[float]]]) -> dict[str, float]:
    """Means by combination, over hands and digits."""
    names = dict.fromkeys(
        item.name for digit in ("index", "thumb") for item in combinations(HPAC.digits[digit])
    )
    pooled = {name: [value for entry in tables for value in entry.get(name, ())] for name in names}
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
    Column("coverage", "", lambda hands: _pooled([hand.inside for hand in hands])),
    Column("told", "", lambda hands: _pooled([hand.told for hand in hands])),
)
"""Coverage of the intervals, which has a separate table in the report."""


def calibration(count: int, seed: int, in_physics: int = 0) -> Part:
    """`hpac calibrate` on hidden hands of every kind: `count` of each law in metal, `in_physics` in
    the physics engine.
    """
    found = {laws: run_hidden(count, seed, laws) for laws in LAWS}
    if in_physics:
        found["physics engine"] = run_hidden_in_physics(in_physics, seed)
    rows = rows_of((*COLUMNS, *COVERAGE), found)
    lines = [
        f"## `hpac calibrate` on hidden hands, seed {seed}",
        "",
        table("hidden", COLUMNS, rows),
        "",
    ]
    fit = rows["laws of the fit"]
    body = [
        (name, f"{share:.0%}", f"{fit['told'][name]:.0%}")
        for name, share in fit["coverage"].items()
    ]
    lines += [
        markdown(
            ("combination", "95 % interval contains the truth", "determined by the data"), body
        ),
        "",
    ]
    if in_physics:
        shares = rows["physics engine"]["coverage"].values()
        lines += [
            f"In the physics engine {np.mean(list(shares)):.0%} of the intervals hold the truth.",
            "",
        ]
    return Part("\n".join(lines), rows)


# Exchanged labels -----------------------------------------------------------------------

KINDS = ("as labelled", "MCP and DIP", "another pair of a digit", "joints of two digits")
"""Kinds of exchange of two joints' labels."""


def exchanged(record: Sweep, first: int, second: int) -> Sweep:
    """The record with the columns of two joints exchanged."""
    joint_pos = record.joint_pos.copy()
    joint_pos[:, [first, second]] = joint_pos[:, [second, first]]
    return record.with_joint_pos(joint_pos)


def verdict(record: Sweep) -> str:
    """Whether the checks of `hpac sweep` and `hpac calibrate` refuse a record, remark on it or take
    it.
    """
    try:
        return "remark" if judged(record, HPAC) else "taken"
    except RecordError:
        return "refused"


def verdicts(record: Sweep, rng: np.random.Generator) -> dict[str, list[str]]:
    """Verdicts on every segment by kind of exchange: all pairs of a digit, and each joint with a
    random one of another digit.
    """
    found: dict[str, list[str]] = {kind: [] for kind in KINDS}
    as_labelled, mcp_and_dip, of_a_digit, of_two_digits = found.values()
    for rows in record.segments():
        segment = record[rows]
        own = joints_of_servo(int(record.swept[rows[0]]))
        others = [
            joint for joint in range(len(JOINTS)) if joint not in (*own, JOINT_INDEX["thumb_cmc"])
        ]
        as_labelled.append(verdict(segment))
        for pair in itertools.combinations(own, 2):
            parts = {JOINTS[joint].partition("_")[2] for joint in pair}
            (mcp_and_dip if parts == {"mcp", "dip"} else of_a_digit).append(
                verdict(exchanged(segment, *pair))
            )
        of_two_digits += [
            verdict(exchanged(segment, joint, int(rng.choice(others)))) for joint in own
        ]
    return found


def _shares(kind: str, result: str) -> Column:
    return Column(
        f"{kind}, {result}",
        f"{kind}: {result}",
        lambda found: found[kind].count(result) / len(found[kind]),
        "{:.1%}",
    )


LABEL_COLUMNS = (
    Column("digits", "digits", lambda found: len(found[KINDS[0]])),
    *(_shares(kind, result) for kind in KINDS[:2] for result in ("refused", "remark")),
    *(_shares(kind, "refused") for kind in KINDS[2:]),
)


def labels(count: int, seed: int, in_physics: int = 0) -> Part:
    """Check records with and without exchanged labels: `count` hidden hands of each law,
    `in_physics` in the physics engine.
    """
    records: dict[str, list[Sweep]] = {}
    for laws, metal in LAWS.items():
        both = metal_sweeps(
            hidden_hands(count, seed, metal),
            seed,
            CAMERA,
            Protocol(both_directions=True),
            SERVOS[:-1],
        )
        both = [without_frames(record, seed, number) for number, record in enumerate(both)]
        records[f"{laws}, points both ways"] = both
        records[f"{laws}, flexion alone"] = [record[record.phase != EXTENDING] for record in both]
    if in_physics:
        records["physics engine, the return filmed"] = [
            record for _, record, *_ in measured_in_physics(in_physics, seed)
        ]
    found = {}
    for name, sweeps in records.items():
        parts = [
            verdicts(record, np.random.default_rng([seed, i]))
            for i, record in enumerate(progress(sweeps, name))
        ]
        found[name] = {kind: [result for part in parts for result in part[kind]] for kind in KINDS}
    rows = rows_of(LABEL_COLUMNS, found)
    return Part(
        f"## Exchanged labels of joints, hidden hands, seed {seed}\n\n{table('hidden', LABEL_COLUMNS, rows)}\n",
        rows,
    )
