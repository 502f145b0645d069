"""Hands that lack nothing of what a workshop's hand may have, and `hpac calibrate` on two sweeps of
each: ``python -m experiments.imperfect``.

Own laws and own code: none of the fit's, of `quasistatic`'s or of an engine's. A digit's posture is
tabulated over the angle of its motor in either direction, with hardening tendons, EA/L in both
segments, slack in the loops, pretension, losses at the guides, a sliding return cable, pins, gear
play and soft servos; friction holds a joint between the two tables. Potentiometers bend, servos warm
up, and each sweep has a camera set up anew, whose scale and plane are off. All sizes are chosen."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from experiments.bench import rest_pose
from experiments.results import Column, Interval, range_of, rows_of, table
from hpac_gym.calibration.doubts import doubts
from hpac_gym.calibration.file_errors import BOUND, check_errors, expected_worst_deg, file_errors
from hpac_gym.calibration.fitting import IdentificationError
from hpac_gym.calibration.identification import identify
from hpac_gym.calibration.judging import judged
from hpac_gym.calibration.record import (
    EXTENDING,
    FLEXING,
    REST,
    RecordError,
    Sweep,
    concatenate,
    joints_of_servo,
)
from hpac_gym.command import run_module, whole_number
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, Digit, Hand
from hpac_gym.model.checks import Array
from hpac_gym.model.files import hand_from_toml, hand_to_toml
from hpac_gym.model.settled import settled_joints_from_servo, settled_servo_from_synergy
from hpac_gym.model.variation import scaled_digit
from hpac_gym.output import writable_file, write_text
from hpac_gym.progress import progress

SEED = 33_400
"""First seed of the hands; no other experiment uses it."""
CHOSEN_ON = 1000
JUDGED_ON = 2000
"""First hands on which the bound and the thresholds of `hpac calibrate` were chosen, and judged."""
OUT = Path("docs/results/experiments/imperfect.json")
CMC = len(SERVOS) - 1
POINTS = 31
POINT_S = 1.5
HOLD_S = 0.5
REST_S = 2.0
RATE_HZ = 20.0
POSTURES = 40
"""Number of held-out postures that are commanded."""
_GRID = 160  # angles of the root joint at which a digit is tabulated
_ROUNDS = 40
_HALVINGS = 32


# A digit ---------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Imperfections:
    """What one digit and its servo have beyond the model's parameters."""

    zero: float
    """Angle of the horn at the command 0, slack included [rad]."""
    servo_stiffness: float
    """[N·m/rad]."""
    play: float
    """Play of the gear, taken up by the tendon's pull [rad]."""
    dead_band: float
    """[rad]."""
    pot: tuple[float, float, float]
    """Bend of the potentiometer: amplitude [rad], waves per radian [rad/rad], phase [rad]."""
    pins: float
    """Radius of the guide pins, negative if the tendon runs round their far side [m]."""
    pretension: float
    """Tension of the return spring with the digit straight [N]."""
    slack: float
    """Slack of every coupling loop [m]."""
    hardening: float
    """Growth of a tendon's stiffness with its stretch [1/m]."""
    capstan: float
    """Share of the drive's tension that its guides take."""
    sliding: float
    """Friction coefficient of the return cable round the joints."""
    joint_friction: float
    """[N·m]."""
    tendon_friction: float
    """Share of the load."""
    stop: tuple[float, ...]
    """[rad]."""


def drawn(rng: np.random.Generator, digit: Digit) -> Imperfections:
    """Imperfections of one digit."""
    return Imperfections(
        zero=np.deg2rad(2.0) * rng.standard_normal(),
        servo_stiffness=rng.uniform(10, 30),
        play=np.deg2rad(rng.uniform(0.1, 0.5)),
        dead_band=rng.uniform(5e-4, 2e-3),
        pot=(np.deg2rad(rng.uniform(0.15, 0.5)), rng.uniform(2, 6), rng.uniform(0, 2 * np.pi)),
        pins=rng.choice((-1, 1)) * rng.uniform(0.3e-3, 1e-3),
        pretension=rng.uniform(0.2, 1.5),
        slack=rng.uniform(0, 5e-5),
        hardening=rng.uniform(0, 300),
        capstan=rng.uniform(0.02, 0.1),
        sliding=rng.uniform(0, 0.08),
        joint_friction=1e-3 * np.exp(0.4 * rng.standard_normal()),
        tendon_friction=0.03 * np.exp(0.4 * rng.standard_normal()),
        stop=tuple(
            HPAC.workspace[joint][1] + np.deg2rad(rng.uniform(0, 3)) for joint in digit.joints
        ),
    )


def tabulated(digit: Digit, more: Imperfections, way: float) -> tuple[Array, Array]:
    """Motor angles (k,) and joint angles (k, joints) [rad] of a slow motion in one direction, +1 or
    −1, with all friction against it.
    """
    radius = np.array(digit.joint_radius)
    stiffness = digit.tendon_stiffness / np.array(digit.path_length)
    count = len(radius)
    root = np.linspace(0.0, more.stop[0], _GRID)
    joint_pos = np.zeros((_GRID, count))
    joint_pos[:, 0] = root
    pull = 1 - way * more.tendon_friction
    lag = 1 + way * more.tendon_friction

    def coupling(segment: int, angles: Array) -> Array:
        stretch = (
            radius[segment] * angles[:, segment] - radius[segment + 1] * angles[:, segment + 1]
        )
        stretch = np.maximum(stretch - more.slack, 0.0)
        return stiffness[segment] * stretch * (1 + more.hardening * stretch)

    def extending(joint: int, angles: Array) -> Array:
        """Torque of friction, return cable and the next segment against flexion [N·m]."""
        tension = more.pretension + digit.spring_stiffness * angles @ radius
        tension = tension * np.exp(way * more.sliding * angles[:, : joint + 1].sum(axis=1))
        after = coupling(joint, angles) if joint < count - 1 else 0.0
        return radius[joint] * lag * (tension + after) + way * more.joint_friction

    for _ in range(_ROUNDS):
        for joint in range(1, count):
            low = np.zeros(_GRID)
            high = np.full(_GRID, more.stop[joint])
            for _ in range(_HALVINGS):
                joint_pos[:, joint] = (low + high) / 2
                flexing = radius[joint] * pull * coupling(joint - 1, joint_pos)
                flexes = flexing > extending(joint, joint_pos)
                low = np.where(flexes, joint_pos[:, joint], low)
                high = np.where(flexes, high, joint_pos[:, joint])
    included = digit.alpha - root
    chord = np.sqrt(digit.d1**2 + digit.d2**2 - 2 * digit.d1 * digit.d2 * np.cos(included))
    arm = digit.d1 * digit.d2 * np.sin(included) / chord - more.pins
    tension = np.maximum(extending(0, joint_pos), 0.0) / (pull * arm)
    at_servo = tension * (1 + way * more.capstan)
    mean = (tension + at_servo) / 2
    stretch = 2 * mean / digit.drive_stiffness
    stretch /= 1 + np.sqrt(1 + 4 * more.hardening * mean / digit.drive_stiffness)
    horn = (digit.rest_chord - chord - more.pins * root + stretch) / digit.servo_radius
    twist = at_servo * digit.servo_radius / more.servo_stiffness
    return np.maximum.accumulate(horn + more.play + twist), joint_pos


@dataclass(frozen=True, slots=True)
class BuiltDigit:
    """A digit with imperfections, as two tables."""

    more: Imperfections
    flexion: tuple[Array, Array]
    extension: tuple[Array, Array]

    def course(self, command: Array, warm: Array) -> Array:
        """Joint angles (k, joints) along a slow path of commands (k,) from the open digit [rad];
        `warm` is the shift of the servo's zero (k,) [rad].
        """
        height, waves, phase = self.more.pot
        motor = command + self.more.zero + warm + height * np.sin(waves * command + phase)
        way = np.sign(np.diff(command, prepend=command[0] - 1e-9))
        motor = motor - way * self.more.dead_band
        least, most = (
            np.stack([np.interp(motor, angles, column) for column in joints.T], axis=1)
            for angles, joints in (self.flexion, self.extension)
        )
        course = np.empty_like(least)
        last = np.zeros(least.shape[1])
        for step in range(len(motor)):
            last = np.minimum(np.maximum(last, least[step]), np.maximum(most[step], least[step]))
            course[step] = last
        return course


# A hand and its sessions -----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ImperfectHand:
    """A hand with everything missing from the model at once."""

    hand: Hand
    digits: tuple[BuiltDigit, ...]
    cmc: Imperfections

    @classmethod
    def drawn(cls, seed: int) -> ImperfectHand:
        """The hand of a seed."""
        rng = np.random.default_rng([SEED, seed])
        hand = replace(
            HPAC,
            digits={name: _near(digit, rng) for name, digit in HPAC.digits.items()},
            cmc_gain=HPAC.cmc_gain * (1 + 0.01 * rng.standard_normal()),
        )
        digits = []
        for digit in hand.digits.values():
            more = drawn(rng, digit)
            digits.append(
                BuiltDigit(more, tabulated(digit, more, 1.0), tabulated(digit, more, -1.0))
            )
        return cls(hand, tuple(digits), drawn(rng, hand.digits["thumb"]))

    def course(self, servo: Array, time: Array, session: Session) -> Array:
        """Joint angles (k, 15) along a slow path of servo angles (k, 6) from the open hand [rad]."""
        joint_pos = np.zeros((len(servo), len(JOINTS)))
        for column, (digit, built) in enumerate(
            zip(self.hand.digits.values(), self.digits, strict=True)
        ):
            warm = session.warm[column] * (1 - np.exp(-time / session.warming_s))
            names = [JOINT_INDEX[joint] for joint in digit.joints]
            joint_pos[:, names] = built.course(servo[:, column], warm)
        height, waves, phase = self.cmc.pot
        command = servo[:, CMC]
        horn = command + self.cmc.zero + height * np.sin(waves * command + phase)
        horn += session.warm[CMC] * (1 - np.exp(-time / session.warming_s)) - self.cmc.dead_band
        joint_pos[:, JOINT_INDEX["thumb_cmc"]] = np.maximum(self.hand.cmc_gain * horn, 0.0)
        return joint_pos


def _near(digit: Digit, rng: np.random.Generator) -> Digit:
    """A digit within ±3 % of its geometry and ±25 % of its stiffnesses."""
    sizes = dict.fromkeys(
        ("d1", "d2", "alpha", "servo_radius", "joint_radius", "path_length"), 0.03
    )
    sizes |= dict.fromkeys(("spring_stiffness", "tendon_stiffness", "drive_stiffness"), 0.25)
    return scaled_digit(
        digit,
        {
            name: 1 + size * rng.uniform(-1, 1, np.shape(getattr(digit, name)))
            for name, size in sizes.items()
        },
    )


@dataclass(frozen=True, slots=True)
class Session:
    """One use of the hand: how its servos warm up, and the camera as it was set up."""

    warm: Array
    """Shift of each servo's zero once it is warm, shape (6,) [rad]."""
    warming_s: float
    scale: float
    """Relative error of the camera's angles."""
    plane: Array
    """Amplitude of the error with sin 2q of a camera that is not square, by servo, shape (6,)
    [rad].
    """
    noise: float
    """Standard deviation of a sample [rad]."""
    rng: np.random.Generator

    @classmethod
    def drawn(cls, seed: int, number: int) -> Session:
        """A hand's session of a number."""
        rng = np.random.default_rng([SEED, seed, 1 + number])
        return cls(
            np.deg2rad(0.3) * rng.standard_normal(len(SERVOS)),
            rng.uniform(60, 400),
            0.003 * rng.standard_normal(),
            np.deg2rad(rng.uniform(-0.3, 0.3, len(SERVOS))),
            np.deg2rad(rng.uniform(0.05, 0.15)),
            rng,
        )

    def seen(self, joint_pos: Array, time: Array, swept: int) -> Array:
        """What the camera makes of true angles (k, 15) at times (k,) [s], the digit in its plane."""
        wander = np.zeros(len(time))
        steps = np.deg2rad(0.06) * self.rng.standard_normal(len(time))
        kept = np.exp(-np.diff(time) / 3.0)
        wander[0] = steps[0]
        for i, share in enumerate(kept, 1):
            wander[i] = share * wander[i - 1] + np.sqrt(1 - share**2) * steps[i]
        drift = np.deg2rad(0.15) * self.rng.standard_normal(len(JOINTS))
        seen = joint_pos * (1 + self.scale) + self.plane[swept] * np.sin(2 * joint_pos)
        seen = seen + wander[:, None] + drift * ((time - time[0]) / np.ptp(time))[:, None]
        return seen + self.noise * self.rng.standard_normal(seen.shape)


def swept(hand: ImperfectHand, session: Session, both_ways: bool) -> Sweep:
    """The record of one session: every servo in turn, the held frames of its points, and rests with
    slack tendons.
    """
    return concatenate(
        [_segment(hand, session, column, both_ways) for column in range(len(SERVOS))]
    )


def _segment(hand: ImperfectHand, session: Session, column: int, both_ways: bool) -> Sweep:
    point = np.arange(POINTS)
    phase = np.full(POINTS, FLEXING)
    if both_ways:
        point = np.concatenate([point, point[::-1]])
        phase = np.repeat([FLEXING, EXTENDING], POINTS)
    held = round(HOLD_S * RATE_HZ) - 1
    rest = round(REST_S * RATE_HZ)
    ends = REST_S + POINT_S * np.arange(1, len(point) + 1)
    holds = (ends[:, None] - np.arange(held)[::-1] / RATE_HZ).ravel()
    time = np.concatenate(
        [np.arange(rest) / RATE_HZ, holds, holds[-1] + (1 + np.arange(rest)) / RATE_HZ]
    )
    servo = np.tile(rest_pose(SERVOS[column]), (len(time), 1))
    angles = np.linspace(HPAC.servo_min[column], HPAC.servo_max[column], POINTS)[point]
    servo[:, column] = np.pad(np.repeat(angles, held), rest)
    start = column * (time[-1] + 10.0)
    joint_pos = hand.course(servo, start + time, session)
    still = np.ones(len(JOINTS), dtype=bool)
    still[joints_of_servo(column)] = False
    joint_pos[:, still] = 0.0
    joint_pos[np.r_[:rest, -rest:0]] = 0.0
    if column != CMC:
        joint_pos[:, JOINT_INDEX["thumb_cmc"]] = servo[:, SERVO_INDEX["thumb_cmc"]]
    zeros = np.zeros(len(time), dtype=int)
    return Sweep(
        zeros,
        zeros + column,
        np.pad(np.repeat(phase, held), rest, constant_values=REST),
        np.pad(np.repeat(point, held), rest, constant_values=-1),
        time,
        servo,
        session.seen(joint_pos, time, column),
    )


def true_errors_deg(hand: ImperfectHand, session: Session, file: Hand, seed: int) -> Array:
    """Mean absolute difference between the angles that a file promises for its commands and the true
    ones, by joint, over held-out postures; NaN where a joint never leaves a stop [°].

    Each posture is approached from the open hand, and is free if no joint of the digit is at a stop.
    """
    rng = np.random.default_rng([SEED, seed, 9])
    share = rng.uniform(0.05, 0.95, (POSTURES, len(SERVOS)))
    synergy = HPAC.synergy_min + share * (HPAC.synergy_max - HPAC.synergy_min)
    servo = np.clip(settled_servo_from_synergy(synergy, file), HPAC.servo_min, HPAC.servo_max)
    time = rng.uniform(0, 600, POSTURES)
    reached = np.concatenate(
        [hand.course(u[None], t[None], session) for u, t in zip(servo, time, strict=True)]
    )
    off = np.degrees(np.abs(settled_joints_from_servo(servo, file) - reached))
    for digit, built in zip(hand.hand.digits.values(), hand.digits, strict=True):
        joints = [JOINT_INDEX[joint] for joint in digit.joints]
        stopped = (reached[:, joints] > np.array(built.more.stop) - 1e-6).any(axis=1)
        off[np.ix_(stopped, joints)] = np.nan
    return np.nanmean(off, axis=0)


# Calibrated and judged -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Judged:
    """What `hpac calibrate` says of one hand, and the truth."""

    seed: int
    refused: str = ""
    alone_deg: float = np.nan
    """The first line's error of the worst joint without a second sweep [°]."""
    told_deg: float = np.nan
    """The same with a second sweep."""
    true_deg: float = np.nan
    """True error of the worst joint."""
    median_deg: float = np.nan
    """True error of the median joint."""
    nominal_deg: float = np.nan
    """True error of the median joint with the nominal hand."""
    remarks: int = 0

    @property
    def fold(self) -> float:
        """Factor between the told error and the true one, at least 1."""
        return max(self.told_deg / self.true_deg, self.true_deg / self.told_deg)


def judge(seed: int, both_ways: bool) -> Judged:
    """Sweep a hand in two sessions, calibrate it as `hpac calibrate sweep.csv --check sweep2.csv`
    does, and command it in a third.
    """
    hand = ImperfectHand.drawn(seed)
    first, second, third = (Session.drawn(seed, number) for number in range(3))
    record = swept(hand, first, both_ways)
    again = swept(hand, second, both_ways)
    try:
        remarks = judged(record, HPAC) + judged(again, HPAC)
        found = identify(record, hold_out=True)
        remarks += doubts(found, HPAC)
    except (RecordError, IdentificationError) as error:
        return Judged(seed, str(error))
    file = hand_from_toml(hand_to_toml(found.hand), "the calibrated hand")
    alone = max(error.mean_abs_deg for error in file_errors(found, file).values())
    told = expected_worst_deg(check_errors(again, file, HPAC))
    true = true_errors_deg(hand, third, file, seed)
    nominal = true_errors_deg(hand, third, HPAC, seed)
    worst, median, nominal_median = map(
        float, (np.nanmax(true), np.nanmedian(true), np.nanmedian(nominal))
    )
    return Judged(seed, "", alone, told, worst, median, nominal_median, len(remarks))


def _bound_holds(hands: Sequence[Judged]) -> Interval:
    """Share of the hands within the stated bound, with its Wilson interval."""
    held = sum(hand.true_deg <= BOUND * hand.told_deg for hand in hands)
    return Interval(held / len(hands), *wilson_interval(held, len(hands)))


COLUMNS = (
    Column("hands", "hands", len),
    *(
        Column(
            key, heading, lambda hands, key=key: range_of([getattr(h, key) for h in hands]), form
        )
        for key, heading, form in (
            ("nominal_deg", "nominal hand, median joint [°]", "{:.1f}"),
            ("median_deg", "file, median joint", "{:.2f}"),
            ("true_deg", "file, worst joint", "{:.2f}"),
        )
    ),
    Column(
        "understates",
        "true / told without a second sweep",
        lambda hands: range_of([hand.true_deg / hand.alone_deg for hand in hands]),
        "{:.2f}",
    ),
    Column(
        "ratio",
        "true / told with it",
        lambda hands: range_of([hand.true_deg / hand.told_deg for hand in hands]),
        "{:.2f}",
    ),
    Column("fold", "off by a factor", lambda hands: range_of([h.fold for h in hands]), "{:.2f}"),
    Column("bound_holds", "95 % bound holds", _bound_holds, "{:.0%}"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command's options."""
    parser.add_argument("--hands", type=whole_number(2), default=40, help="hands (%(default)s)")
    parser.add_argument(
        "--chosen-on", action="store_true", help="the hands on which bounds were chosen"
    )
    parser.add_argument("--out", type=Path, default=OUT, metavar="JSON")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Judge the hands with either protocol, print the table and write it."""
    writable_file(arguments.out)
    start = CHOSEN_ON if arguments.chosen_on else JUDGED_ON
    found = {}
    for name, both_ways in (("flexion alone", False), ("points both ways", True)):
        seeds = progress(range(start, start + arguments.hands), name)
        found[name] = [judge(seed, both_ways) for seed in seeds]
    taken = {name: [hand for hand in hands if not hand.refused] for name, hands in found.items()}
    rows = rows_of(COLUMNS, taken)
    refused = [f"{name} {hand.seed}" for name in found for hand in found[name] if hand.refused]
    command = f"python -m experiments.imperfect --hands {arguments.hands}"
    command += " --chosen-on" if arguments.chosen_on else ""
    data = {"command": command, "bound": BOUND, "refused": refused, "rows": rows, "hands": found}
    write_text(arguments.out, json.dumps(data, indent=1, default=asdict) + "\n")
    print(f"{table('protocol', COLUMNS, rows)}\n\nrefused: {', '.join(refused) or 'none'}")
    print(f"written to {arguments.out}")
    return 0


if __name__ == "__main__":
    sys.exit(run_module("experiments.imperfect", __doc__, add_arguments))
