"""Accuracy of command maps on hands in metal, before and after calibration from a sweep.

A command map converts a target to servo angles and predicts the resulting joint angles. The error
is the difference between prediction and true angles; the distance from prediction to target, which
a digit with one servo cannot avoid, is separate."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np

from experiments.bench import JointCamera, Protocol, metal_sweeps
from experiments.populations import ALL_BELOW_DEG, NINE, Workshop, build
from experiments.quasistatic import Built, hand_course
from experiments.results import Column, Part, part_of, range_of
from hpac_gym.calibration.identification import identify
from hpac_gym.model import (
    HPAC,
    SERVOS,
    Array,
    Calibration,
    Hand,
    clip_to_workspace,
    elastic_joints_from_servo,
    joints_from_synergy,
    scaled_hand,
    servo_from_joints,
)
from hpac_gym.model.settled import (
    EXTENSION,
    FLEXION,
    settled_joints_from_servo,
    settled_servo_from_joints,
)
from hpac_gym.progress import progress

GOAL_DEG = 0.15
"""Goal for the mean error of each of the nine joints, in 95 % of the hands [°]."""
TARGETS = 25
CAMERA = JointCamera(outliers=0.005)
_STEPS = 3  # quasi-static, from target to target

Map = Callable[[Array, Hand, float], tuple[Array, Array]]
"""Function from targets (k, 15), hand and direction to servo angles (k, 6) and predicted joint
angles (k, 15).
"""


def papers_map(targets: Array, hand: Hand, direction: float) -> tuple[Array, Array]:
    """Eqs. (14), (15) with a hand's parameters; the prediction is Eqs. (5), (12)."""
    servo = servo_from_joints(clip_to_workspace(targets, hand), hand)
    return servo, elastic_joints_from_servo(servo, hand)


def settled_map(targets: Array, hand: Hand, direction: float) -> tuple[Array, Array]:
    """Inverse of the identified hand with drive stretch, zeros and friction."""
    servo = settled_servo_from_joints(clip_to_workspace(targets, hand), hand, direction)
    servo = np.clip(servo, hand.servo_min, hand.servo_max)
    return servo, settled_joints_from_servo(servo, hand, direction)


def _calibrated(hand: Hand, **changes: object) -> Hand:
    return replace(hand, calibration=replace(hand.calibration, **changes))


MAPS: dict[str, tuple[Map, Callable[[Hand], Hand]]] = {
    "paper's map, nominal numbers": (papers_map, lambda hand: HPAC),
    "paper's map, identified numbers": (papers_map, lambda hand: hand),
    "identified, all of it": (settled_map, lambda hand: hand),
    "… without the drive's stretch": (
        settled_map,
        lambda hand: scaled_hand(hand, {"drive_stiffness": 1e4}),
    ),
    "… without the zeros": (
        settled_map,
        lambda hand: _calibrated(hand, servo_zero=Calibration().servo_zero),
    ),
    "… without friction": (
        settled_map,
        lambda hand: _calibrated(hand, friction=Calibration().friction),
    ),
    "… friction of flexion both ways": (
        lambda targets, hand, direction: settled_map(targets, hand, FLEXION),
        lambda hand: hand,
    ),
}
"""Command maps by name, each with the function that selects its parameters from the identified
hand.
"""

BEFORE_AND_AFTER = ("paper's map, nominal numbers", "identified, all of it")


@dataclass(frozen=True, slots=True)
class MapErrors:
    """Errors of one command map on a population: means over the targets for the nine joints, shape
    (hands, 9) [°].
    """

    flexion: Array
    """Error of the predicted angles in flexion, from the open hand."""
    extension: Array
    """Error of the predicted angles in extension, from the closed hand."""
    off_target: Array
    """Distance of the prediction from the target, which no command can remove."""


COLUMNS = (
    Column(
        "flexion_worst",
        "flexion: worst of nine [°]",
        lambda found: range_of(found.flexion.max(axis=1)),
        "{:.2f}",
    ),
    Column(
        "all_within_goal",
        f"hands with all nine ≤ {GOAL_DEG}°",
        lambda found: _share(found.flexion <= GOAL_DEG),
        "{:.0%}",
    ),
    Column(
        "all_below_papers",
        f"< {ALL_BELOW_DEG}°",
        lambda found: _share(found.flexion < ALL_BELOW_DEG),
        "{:.0%}",
    ),
    Column(
        "extension_worst",
        "extension: worst of nine",
        lambda found: range_of(found.extension.max(axis=1)),
        "{:.2f}",
    ),
    Column(
        "all_within_goal_back",
        f"hands with all nine ≤ {GOAL_DEG}°",
        lambda found: _share(found.extension <= GOAL_DEG),
        "{:.0%}",
    ),
    Column(
        "off_target", "off target", lambda found: range_of(found.off_target.max(axis=1)), "{:.2f}"
    ),
)


def _share(well: np.ndarray) -> float:
    """Share of the hands whose nine joints are all True in ``well``, shape (hands, 9)."""
    return float(well.all(axis=1).mean())


def commands(
    name: str, workshop: Workshop, count: int, seed: int, maps: Collection[str] = tuple(MAPS)
) -> Part:
    """Sweep and calibrate every hand of a workshop once, then command it through its range and back
    with each of the `MAPS`.
    """
    built = build(workshop, count, seed)
    records = metal_sweeps(built, seed, CAMERA, Protocol(both_directions=True), servos=SERVOS[:-1])
    identified = [identify(record).hand for record in progress(records, "calibrations")]
    found = {
        item: errors_of_map(item, built, identified) for item in progress(maps, "command maps")
    }
    title = (
        f"Commands: {count} hands ({name}), seed {seed}, one sweep each; median and the middle 95 %"
    )
    return part_of(title, "map", COLUMNS, found)


def errors_of_map(name: str, built: list[Built], identified: list[Hand]) -> MapErrors:
    """Errors of one of the `MAPS` on hands, given the parameters identified for each."""
    command, hand_of = MAPS[name]
    share = np.linspace(0.0, 1.0, TARGETS)[1:, None]
    targets = joints_from_synergy(HPAC.synergy_min + share * (HPAC.synergy_max - HPAC.synergy_min))
    ways = [(targets, FLEXION), (targets[::-1], EXTENSION)]
    told = [
        [command(wanted, hand_of(hand), direction) for wanted, direction in ways]
        for hand in identified
    ]
    servo, promised = (
        np.array([np.concatenate([way[i] for way in there_and_back]) for there_and_back in told])
        for i in (0, 1)
    )
    start = np.zeros((len(built), 1, len(SERVOS)))
    reached = hand_course(built, np.concatenate([start, servo], axis=1), _STEPS)[:, 1:]
    error = np.degrees(np.abs(reached - promised))[:, :, NINE]
    half = len(targets)
    off_target = np.degrees(np.abs(promised[:, :half] - targets))[:, :, NINE]
    return MapErrors(
        error[:, :half].mean(axis=1), error[:, half + 1 :].mean(axis=1), off_target.mean(axis=1)
    )
