"""Both directions and repeated trials: hysteresis and trial-to-trial spread of every joint."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.results import Column, Interval, Part, mean_of, part_of
from experiments.sweep import Reference
from hpac_gym.calibration.processing import points, processed
from hpac_gym.calibration.record import EXTENDING, FLEXING, Sweep, concatenate, joints_of_servo
from hpac_gym.figures import BLUE, GREY, label, new_figure
from hpac_gym.model import JOINTS, SERVOS, Array
from hpac_gym.progress import progress

DRIVEN = (0.1, 0.9)
"""Part of the servo's range over which a hysteresis is averaged, excluding the ends, where the
direction reverses.
"""


class JointTrials(NamedTuple):
    """Servo angles (k,) and measured angles of one joint in all trials, shape (trials, k) [rad]."""

    servo: Array
    flexion: Array
    extension: Array


def run_trials(
    reference: Reference, count: int, seed: int, servos: tuple[str, ...] = SERVOS
) -> Sweep:
    """Simulate sweeps in both directions; friction and the tendons' seats vary from trial to
    trial.
    """
    parts = []
    for trial in progress(range(count), "trials"):
        rng = np.random.default_rng([seed, trial])
        factor = max(1 + reference.friction_spread * rng.standard_normal(), 0.0)
        settings = replace(
            reference.rig.settings,
            joint_friction=factor * reference.rig.settings.joint_friction,
            tendon_friction=factor * reference.tendon_friction,
            slack=tuple((reference.seat * rng.standard_normal(5)).tolist()),
        )
        rig = replace(reference.rig, settings=settings).with_protocol(both_directions=True)
        parts.append(rig.sweep(rng, trial=trial, servos=servos))
    return concatenate(parts)


def by_joint(found: Sweep) -> dict[str, JointTrials]:
    """The trials of every swept joint, one row per trial, in the order of the points."""
    return {
        JOINTS[joint]: JointTrials(
            _table(found, int(servo), found.servo[:, servo], FLEXING)[0],
            _table(found, int(servo), found.joint_pos[:, joint], FLEXING),
            _table(found, int(servo), found.joint_pos[:, joint], EXTENDING),
        )
        for servo in np.unique(found.swept)
        for joint in joints_of_servo(int(servo))
    }


def _table(found: Sweep, servo: int, values: Array, phase: int) -> Array:
    rows = (found.swept == servo) & (found.phase == phase)
    return values[rows].reshape(len(np.unique(found.trial[rows])), -1)


def hysteresis_width(joint: JointTrials) -> Array:
    """Extension minus flexion at equal servo angles, averaged over `DRIVEN`, for every trial, shape
    (trials,) [rad].
    """
    share = (joint.servo - joint.servo[0]) / (joint.servo[-1] - joint.servo[0])
    inside = (share >= DRIVEN[0]) & (share <= DRIVEN[1])
    return (joint.extension - joint.flexion)[:, inside].mean(axis=1)


def spread_deg(joint: JointTrials) -> Interval:
    """Root mean square over the points of the trial-to-trial standard deviation, jackknifed over
    trials [°].
    """
    count = len(joint.flexion)
    whole = _rms_spread(joint.flexion)
    left = [
        count * whole - (count - 1) * _rms_spread(np.delete(joint.flexion, trial, axis=0))
        for trial in range(count)
    ]
    interval = mean_of(np.degrees(left))
    return replace(interval, middle=float(np.degrees(whole)), low=max(interval.low, 0.0))


def _rms_spread(flexion: Array) -> float:
    return float(np.sqrt((flexion.std(axis=0, ddof=1) ** 2).mean()))


COLUMNS = (
    Column(
        "hysteresis_width_deg",
        "hysteresis width [°]",
        lambda joint: mean_of(np.degrees(hysteresis_width(joint))),
        "{:.3f}",
    ),
    Column("trial_to_trial_sd_deg", "trial-to-trial standard deviation [°]", spread_deg, "{:.3f}"),
)


def trials(reference: Reference, count: int, seed: int) -> Part:
    """Hysteresis and repeatability of every joint."""
    joints = by_joint(points(processed(run_trials(reference, count, seed))))
    return part_of(
        f"Both directions and repeated trials: {count} trials, seed {seed}; mean and 95 % interval",
        "joint",
        COLUMNS,
        {label(name): joint for name, joint in joints.items()},
        figures={"hysteresis": hysteresis_figure(joints)},
        caption=f"reference hand, {count} trials, seed {seed}",
    )


def hysteresis_figure(joints: dict[str, JointTrials]) -> Figure:
    """Figure of extension minus flexion over the servo's angle, one line per trial."""
    figure = new_figure(13, 8)
    axes = figure.subplots(3, 5, sharey=True)
    # At rest, the first point, they differ ten times as much: those points are cut off, and told.
    widths = {name: np.degrees(joint.extension - joint.flexion) for name, joint in joints.items()}
    rest = max(np.abs(width[:, 0]).max() for width in widths.values())
    axes[0, 0].set_ylim(-0.15, 1.1 * max(width[:, 1:].max() for width in widths.values()))
    for axis, (name, joint) in zip(axes.flat, joints.items(), strict=False):
        width = widths[name]
        axis.plot(np.degrees(joint.servo), width.T, color=BLUE, linewidth=0.9, alpha=0.7)
        axis.axhline(0.0, color=GREY, linewidth=0.8)
        axis.set_title(label(name), fontsize=9)
    figure.supxlabel(
        f"servo angle [°]; the first point, at rest, reaches {rest:.1f}° and is cut off"
    )
    figure.supylabel("extension − flexion [°]")
    return figure
