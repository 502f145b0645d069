"""A population of hands as a workshop would build them: how far the published accuracy carries to the next one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hpac_gym.model import HPAC, JOINTS, Hand, elastic_joints_from_servo, rigid_joints_from_servo
from hpac_gym.progress import progress
from hpac_gym.study.accuracy import EVALUATED
from hpac_gym.study.reference import varied_hand
from hpac_gym.study.statics import Friction, settled_joints

TOLERANCE: Mapping[str, float] = {
    **dict.fromkeys(("d1", "d2", "servo_radius", "joint_radius"), 0.001),
    **dict.fromkeys(("path_length", "spring_stiffness", "tendon_stiffness"), 0.03),
}
"""Relative standard deviations: 0.1 % on radii and guides, 3 % on k_s, EA and L."""


@dataclass(frozen=True, slots=True)
class Interval:
    """Median and the middle 95 % of a population."""

    median: float
    low: float
    high: float


def mae_of_population(
    count: int, seed: int, hand: Hand, friction: Friction, tolerance: Mapping[str, float] = TOLERANCE, shown: bool = False
) -> dict[str, dict[str, Interval]]:
    """Mean absolute error [°] of many built hands against the nominal model, by kind and joint name.

    The hands rest in closed form (`statics`), without a camera: 41 points over the servos' range.

    Args:
        count: hands to build.
        seed: of their numbers.
        hand: the centre of the population.
        friction: of every hand.
        tolerance: relative standard deviation by field name of `Digit`.
        shown: draw a progress bar.
    """
    servo = np.linspace(HPAC.servo_min, HPAC.servo_max, 41)
    models = {"uncompensated": rigid_joints_from_servo(servo), "compensated": elastic_joints_from_servo(servo)}
    rng = np.random.default_rng(seed)
    errors = {kind: np.empty((count, len(JOINTS))) for kind in models}
    for row in progress(range(count), "population", shown):
        measured = settled_joints(servo, varied_hand(hand, tolerance, rng), friction)
        for kind, model in models.items():
            errors[kind][row] = np.degrees(np.abs(measured - model).mean(axis=0))
    return {
        kind: {name: _interval(values[:, JOINTS.index(name)]) for name in EVALUATED} for kind, values in errors.items()
    }


def _interval(values: np.ndarray) -> Interval:
    low, median, high = np.quantile(values, (0.025, 0.5, 0.975))
    return Interval(float(median), float(low), float(high))
