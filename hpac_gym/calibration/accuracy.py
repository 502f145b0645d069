"""Accuracy of a model on a sweep: residuals, mean absolute errors, and the figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hpac_gym.calibration.record import FLEXING, Sweep
from hpac_gym.figures import GREEN, GREY, RED, label, new_figure
from hpac_gym.model import (
    HPAC,
    JOINTS,
    Hand,
    elastic_joints_from_servo,
    rigid_joints_from_servo,
)
from hpac_gym.model.checks import Array
from hpac_gym.model.settled import settled_joints_from_servo

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EVALUATED = tuple(name for name in JOINTS if name.endswith(("_ip", "_pip", "_dip")))
"""The paper's nine joints: the thumb's IP, and PIP and DIP of the four long fingers."""

FIGURE = tuple(name for name in JOINTS if name != "thumb_cmc")
"""The joints of the paper's figure of mean errors: the nine, MP and MCP."""


@dataclass(frozen=True, slots=True)
class Residuals:
    """Angles of one joint and its servo over a sweep, and δq = q_meas − q_model, all of shape (k,)
    [rad].
    """

    servo: Array
    measured: Array
    uncompensated: Array
    """q_meas − q_ideal with q_ideal = H(u)u."""
    compensated: Array
    """q_meas − q_comp with q_comp = H(u)u − b(q), or the rest angle of a calibrated hand."""


def residuals(points: Sweep, hand: Hand = HPAC) -> dict[str, Residuals]:
    """Residuals of every measured joint at the `processing.points` of its own servo's flexion, over
    all trials; `hand` is not fitted to them.
    """
    rigid = rigid_joints_from_servo(points.servo, hand)
    compensated = settled_joints_from_servo if hand.is_calibrated else elastic_joints_from_servo
    elastic = compensated(points.servo, hand)
    by_joint = {}
    for joint, name in enumerate(JOINTS):
        servo = hand.servo_of_joint[joint]
        flexing = (points.swept == servo) & (points.phase == FLEXING)
        seen = flexing & ~np.isnan(points.joint_pos[:, joint])
        if seen.any():
            measured = points.joint_pos[seen, joint]
            by_joint[name] = Residuals(
                points.servo[seen, servo],
                measured,
                measured - rigid[seen, joint],
                measured - elastic[seen, joint],
            )
    return by_joint


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Mean and largest absolute residual, `uncompensated` and `compensated`, by joint name [°]."""

    mae_deg: dict[str, dict[str, float]]
    max_residual_deg: dict[str, dict[str, float]]


def accuracy(by_joint: dict[str, Residuals]) -> Accuracy:
    """The paper's metrics for the measured joints."""

    def errors(statistic: Callable[[Array], Any]) -> dict[str, dict[str, float]]:
        return {
            kind: {
                name: float(np.degrees(statistic(np.abs(getattr(by_joint[name], kind)))))
                for name in FIGURE
                if name in by_joint
            }
            for kind in ("uncompensated", "compensated")
        }

    return Accuracy(mae_deg=errors(np.mean), max_residual_deg=errors(np.max))


# The paper's two figures -----------------------------------------------------------------

_KINDS = (("uncompensated", RED, "o"), ("compensated", GREEN, "s"))


def residual_figure(by_joint: Mapping[str, Residuals]) -> Figure:
    """The paper's residual figure: the measured of its nine joints over their servo's angle, red
    uncompensated, green compensated.

    The axis shows ±2° as in the paper, or more if the data needs it. Outliers beyond the axis are
    counted in the panel's title."""
    names = [name for name in EVALUATED if name in by_joint]
    rows = -(-len(names) // 3)
    figure = new_figure(11, 8 * max(rows, 1.5) / 3)
    axes = list(figure.subplots(rows, min(len(names), 3), sharey=True, squeeze=False).flat)
    limit = residual_limit(by_joint)
    for axis in axes[len(names) :]:
        axis.set_axis_off()
    for axis, name in zip(axes, names, strict=False):
        axis.set_title(label(name), fontsize=10)
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        axis.set_ylim(-1.05 * limit, 1.05 * limit)  # a point at the limit is shown whole
        beyond = 0
        for kind, color, marker in _KINDS:
            values = np.degrees(getattr(by_joint[name], kind))
            beyond += int((np.abs(values) > limit).sum())
            axis.plot(
                np.degrees(by_joint[name].servo),
                values,
                marker,
                color=color,
                markersize=3,
                label=kind,
            )
        if beyond:
            axis.set_title(
                f"{label(name)} ({beyond} points beyond ±{limit:g}° left out)", fontsize=9
            )
    figure.supxlabel("servo angle u [°]")
    figure.supylabel("residual q_meas − q_model [°]")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", frameon=False)
    return figure


def residual_limit(by_joint: Mapping[str, Residuals]) -> float:
    """Half-range of the residual figure's axis: the paper's 2°, or whole degrees that cover at
    least 98 % of all points [°].
    """
    values = np.concatenate(
        [
            np.degrees(np.abs(getattr(by_joint[name], kind)))
            for name in by_joint
            if name in EVALUATED
            for kind, *_ in _KINDS
        ]
    )
    most, largest = np.quantile(values, (0.98, 1.0))
    return max(2.0, float(np.ceil(largest if largest <= 1.5 * most else most)))


def mae_figure(errors: Accuracy) -> Figure:
    """The paper's bar figure: mean absolute error of each joint, red without and green with
    compensation.

    MP and MCP are shown with the nine joints as in the paper, whose model does not compensate
    them: their bars are equal but for a calibrated hand."""
    names = list(errors.mae_deg["uncompensated"])
    figure = new_figure(13, 4)
    axis = figure.subplots()
    for shift, (kind, color, _) in zip((-0.2, 0.2), _KINDS, strict=True):
        values = [errors.mae_deg[kind][name] for name in names]
        bars = axis.bar(np.arange(len(names)) + shift, values, 0.38, color=color, label=kind)
        axis.bar_label(bars, fmt="%.2f", fontsize=8)
    axis.set_xticks(np.arange(len(names)), [label(name) for name in names], rotation=25)
    axis.set_ylabel("mean absolute error [°]")
    axis.legend(frameon=False)
    return figure
