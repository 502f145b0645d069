"""How well a model predicts a sweep: residuals, mean absolute error, and the workspace that a sweep shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpac_gym.model import HPAC, JOINTS, SERVOS, Hand, elastic_joints_from_servo, rigid_joints_from_servo
from hpac_gym.model.checks import Array
from hpac_gym.study.processing import Points
from hpac_gym.study.record import PHASES, joints_of_servo

EVALUATED = tuple(name for name in JOINTS if name.endswith(("_ip", "_pip", "_dip")))
"""The paper's nine joints: the thumb's IP, and PIP and DIP of the four long fingers."""

FLEXION = PHASES.index("flexion")


@dataclass(frozen=True, slots=True)
class Residuals:
    """δq = q_meas − q_model of one joint over the sweep of its servo."""

    servo: Array
    """Angle of the joint's servo, shape (k,) [rad]."""
    measured: Array
    """q_meas, shape (k,) [rad]."""
    uncompensated: Array
    """Against q_ideal = H(u)u, shape (k,) [rad]."""
    compensated: Array
    """Against q_comp = H(u)u − b(q), shape (k,) [rad]."""


def residuals(points: Points, hand: Hand = HPAC, phase: int = FLEXION) -> dict[str, Residuals]:
    """Residuals of every joint at the points of its own servo's sweep, of all trials.

    Args:
        points: the sweep.
        hand: the model under test; none of the sweep goes into it.
        phase: index in `PHASES`.
    """
    rigid, elastic = rigid_joints_from_servo(points.servo, hand), elastic_joints_from_servo(points.servo, hand)
    found = {}
    for servo in range(len(SERVOS)):
        rows = (points.swept == servo) & (points.phase == phase)
        for joint in joints_of_servo(servo) if rows.any() else ():
            measured = points.joint_pos[rows, joint]
            found[JOINTS[joint]] = Residuals(
                points.servo[rows, servo], measured, measured - rigid[rows, joint], measured - elastic[rows, joint]
            )
    return {name: found[name] for name in JOINTS if name in found}


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors by joint name [°]."""

    mae_deg: dict[str, dict[str, float]]
    """`uncompensated` and `compensated`: mean absolute residual."""
    max_residual_deg: dict[str, dict[str, float]]
    """`uncompensated` and `compensated`: largest absolute residual."""


def accuracy(found: dict[str, Residuals], joints: tuple[str, ...] = EVALUATED) -> Accuracy:
    """The paper's metrics of the joints that were measured."""

    def errors(statistic) -> dict[str, dict[str, float]]:
        return {
            kind: {name: float(np.degrees(statistic(np.abs(getattr(found[name], kind))))) for name in joints if name in found}
            for kind in ("uncompensated", "compensated")
        }

    return Accuracy(mae_deg=errors(np.mean), max_residual_deg=errors(np.max))


def workspace(points: Points) -> dict[str, tuple[float, float]]:
    """Table I of a sweep: smallest and largest angle of each joint while its servo moved [rad]."""
    table = {}
    for name, found in residuals(points).items():
        table[name] = (float(found.measured.min()), float(found.measured.max()))
    return table
