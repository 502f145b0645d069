"""Commands with what a sweep told: how far hands in metal end from where the command map says, before and after calibration.

A command map takes a target to servo angles and says where the joints will be. The error here is between that and where they are;
how far the promise lies from the target, because a digit has one servo and radii of its own, is given beside it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from hpac_gym.model import (
    HPAC,
    JOINTS,
    SERVOS,
    Hand,
    clip_to_workspace,
    elastic_joints_from_servo,
    joints_from_synergy,
    servo_from_joints,
)
from hpac_gym.model.checks import Array
from hpac_gym.model.parameters import Calibration
from hpac_gym.model.settled import EXTENSION, FLEXION, settled_joints_from_servo, settled_servo_from_joints
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import ALL_BELOW_DEG, EVALUATED
from hpac_gym.study.bench import JointCamera, Protocol, metal_sweeps
from hpac_gym.study.identification import identify
from hpac_gym.study.population import Range, Workshop, build, range_of
from hpac_gym.study.quasistatic import follow

GOAL_DEG = 0.15
"""Every one of the nine joints on average, in `GOAL_SHARE` of the hands."""
GOAL_SHARE = 0.95
TARGETS = 25
_NINE = [JOINTS.index(name) for name in EVALUATED]
_KNOTS = 3  # quasi-static steps from target to target

Map = Callable[[Array, Hand, float], tuple[Array, Array]]
"""Targets (k, 15), hand and direction to servo angles (k, 6) and promised joint angles (k, 15)."""


def papers_map(targets: Array, hand: Hand, direction: float) -> tuple[Array, Array]:
    """Eqs. (14), (15) with a hand's numbers; the promise is Eqs. (5), (12)."""
    servo = servo_from_joints(clip_to_workspace(targets, hand), hand)
    return servo, elastic_joints_from_servo(servo, hand)


def settled_map(targets: Array, hand: Hand, direction: float) -> tuple[Array, Array]:
    """The identified hand inverted with drive stretch, zeros and friction."""
    servo = settled_servo_from_joints(clip_to_workspace(targets, hand), hand, direction)
    return servo, settled_joints_from_servo(servo, hand, direction)


def _without(hand: Hand, zero: bool = False, friction: bool = False, drive: bool = False) -> Hand:
    calibration = hand.calibration
    if zero:
        calibration = replace(calibration, servo_zero=Calibration().servo_zero)
    if friction:
        calibration = replace(calibration, friction=Calibration().friction)
    digits = {name: replace(digit, drive_stiffness=1e9) for name, digit in hand.digits.items()} if drive else hand.digits
    return replace(hand, digits=digits, calibration=calibration)


MAPS: dict[str, tuple[Map, Callable[[Hand], Hand]]] = {
    "paper's map, nominal numbers": (papers_map, lambda hand: HPAC),
    "paper's map, identified numbers": (papers_map, lambda hand: hand),
    "identified, all of it": (settled_map, lambda hand: hand),
    "… without the drive's stretch": (settled_map, lambda hand: _without(hand, drive=True)),
    "… without the zeros": (settled_map, lambda hand: _without(hand, zero=True)),
    "… without friction": (settled_map, lambda hand: _without(hand, friction=True)),
    "… friction of flexion both ways": (lambda targets, hand, direction: settled_map(targets, hand, FLEXION), lambda hand: hand),
}


@dataclass(frozen=True, slots=True)
class MapRow:
    """One command map on a population of hands."""

    flexion_worst: Range
    """Mean absolute error of each hand's worst of nine joints, coming from the open hand [°]."""
    extension_worst: Range
    """The same, coming back from the closed hand."""
    all_within_goal: float
    """Share of the hands with all nine joints within `GOAL_DEG` in flexion."""
    all_within_goal_back: float
    all_below_papers: float
    """Share of the hands with all nine joints below the paper's 0.23° in flexion."""
    off_target: Range
    """Worst of nine joints, promise against target, which no command can take away [°]."""


BEFORE_AND_AFTER = ("paper's map, nominal numbers", "identified, all of it")


def run_commanding(
    workshop: Workshop, count: int, seed: int, camera: JointCamera, maps: Iterable[str] = tuple(MAPS), shown: bool = False
) -> dict[str, MapRow]:
    """Sweep and calibrate every hand once, then command it through its range and back with every map.

    Args:
        workshop: how the hands are built.
        count: hands.
        seed: of hands and camera.
        camera: of the calibration sweep, flexion and extension.
        maps: which of `MAPS`.
        shown: draw a progress bar.
    """
    built = build(workshop, count, seed)
    records = metal_sweeps(built, seed, camera, Protocol(both_directions=True), servos=SERVOS[:-1])
    identified = [identify(record).hand for record in progress(records, "calibrations", shown)]
    share = np.linspace(0.0, 1.0, TARGETS)[1:, None]
    targets = joints_from_synergy(HPAC.synergy_min + share * (HPAC.synergy_max - HPAC.synergy_min))
    rows = {}
    for name in progress(list(maps), "command maps", shown):
        command, hand_of = MAPS[name]
        hands = [hand_of(hand) for hand in identified]
        there = [command(targets, hand, FLEXION) for hand in hands]
        back = [command(targets[::-1], hand, EXTENSION) for hand in hands]
        servo, promised = (
            np.array([np.concatenate([first[i], second[i]]) for first, second in zip(there, back, strict=True)]) for i in (0, 1)
        )
        error = np.degrees(np.abs(_reached(built, servo) - promised))[:, :, _NINE]
        half = len(targets)
        ways = error[:, :half].mean(axis=1), error[:, half + 1 :].mean(axis=1)
        missed = np.degrees(np.abs(promised[:, :half] - targets))[:, :, _NINE].mean(axis=1)
        rows[name] = MapRow(
            range_of(ways[0].max(axis=1)),
            range_of(ways[1].max(axis=1)),
            *(float((way.max(axis=1) <= GOAL_DEG).mean()) for way in ways),
            float((ways[0].max(axis=1) < ALL_BELOW_DEG).mean()),
            range_of(missed.max(axis=1)),
        )
    return rows


def _reached(built, servo: Array) -> Array:
    """Where hands rest along their own commands, shape (hands, k, 6) to (hands, k, 15) [rad]."""
    count, steps = servo.shape[:2]
    course = np.zeros((count, steps, len(JOINTS)))
    knots = np.concatenate([np.zeros((count, 1, len(SERVOS))), servo], axis=1)
    fine = np.arange(0, steps + 0.5 / _KNOTS, 1 / _KNOTS)
    for column, name in enumerate(HPAC.digits):
        path = np.stack([np.interp(fine, np.arange(steps + 1), row) for row in knots[:, :, column]], axis=1)
        digits = [item.hand.digits[name] for item in built]
        found = follow(digits, [item.metal[column] for item in built], path)[_KNOTS::_KNOTS]
        course[:, :, [JOINTS.index(joint) for joint in digits[0].joints]] = found.transpose(1, 0, 2)
    return course
