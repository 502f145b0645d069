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

FIGURE = tuple(name for name in JOINTS if name != "thumb_cmc")
"""The joints of the paper's figure of mean errors: the nine, MP and MCP."""

ALL_BELOW_DEG = 0.23
"""The paper: "all nine evaluated joints achieve an MAE below 0.23°"."""

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
            seen = np.flatnonzero(rows)[~np.isnan(points.joint_pos[rows, joint])]
            if seen.size:
                measured = points.joint_pos[seen, joint]
                found[JOINTS[joint]] = Residuals(
                    points.servo[seen, servo], measured, measured - rigid[seen, joint], measured - elastic[seen, joint]
                )
    return {name: found[name] for name in JOINTS if name in found}


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors by joint name [°]."""

    mae_deg: dict[str, dict[str, float]]
    """`uncompensated` and `compensated`: mean absolute residual."""
    max_residual_deg: dict[str, dict[str, float]]
    """`uncompensated` and `compensated`: largest absolute residual."""


def accuracy(found: dict[str, Residuals], joints: tuple[str, ...] = FIGURE) -> Accuracy:
    """The paper's metrics of the joints that were measured."""

    def errors(statistic) -> dict[str, dict[str, float]]:
        return {
            kind: {name: float(np.degrees(statistic(np.abs(getattr(found[name], kind))))) for name in joints if name in found}
            for kind in ("uncompensated", "compensated")
        }

    return Accuracy(mae_deg=errors(np.mean), max_residual_deg=errors(np.max))


PRINTED = (
    "index DIP 1.15 ± 0.05° uncompensated",
    "index DIP 0.18 ± 0.05° compensated",
    "largest residual 2.0 ± 0.1°, the index DIP's",
    "all nine joints below 0.23° compensated",
    "largest reduction at the index DIP, every joint improves",
)
"""What the paper prints of its one hand, with the margins that this project reads it with."""


def met(errors: Accuracy) -> dict[str, bool]:
    """Which of the `PRINTED` figures a sweep shows."""
    before, after = ({name: errors.mae_deg[kind][name] for name in EVALUATED} for kind in ("uncompensated", "compensated"))
    largest = {name: errors.max_residual_deg["uncompensated"][name] for name in EVALUATED}
    gain = {name: before[name] - after[name] for name in EVALUATED}
    facts = (
        abs(before["index_dip"] - 1.15) <= 0.05,
        abs(after["index_dip"] - 0.18) <= 0.05,
        max(largest, key=largest.get) == "index_dip" and abs(largest["index_dip"] - 2.0) <= 0.1,
        max(after.values()) < ALL_BELOW_DEG,
        max(gain, key=gain.get) == "index_dip" and min(gain.values()) > 0,
    )
    return dict(zip(PRINTED, facts, strict=True))


def workspace(points: Points) -> dict[str, tuple[float, float]]:
    """Table I of a sweep: smallest and largest angle of each joint while its servo moved [rad]."""
    table = {}
    for name, found in residuals(points).items():
        table[name] = (float(found.measured.min()), float(found.measured.max()))
    return table
