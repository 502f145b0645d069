"""Both directions and repeated trials: hysteresis and trial-to-trial spread of every joint."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from hpac_gym.model import JOINTS, SERVOS
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.study import figures
from hpac_gym.study.intervals import Mean, mean_of
from hpac_gym.study.processing import Points, points, processed
from hpac_gym.study.record import PHASES, Sweep, concatenate, joints_of_servo
from hpac_gym.study.reference import Reference

DRIVEN = (0.1, 0.9)
"""The part of the servo's range over which a hysteresis is averaged: neither end, where the direction turns."""


@dataclass(frozen=True, slots=True)
class JointTrials:
    """One joint in all trials."""

    servo: Array
    """Shape (k,) [rad]."""
    flexion: Array
    """Shape (trials, k) [rad]."""
    extension: Array
    """Shape (trials, k) [rad]."""


def run_trials(reference: Reference, count: int, seed: int, servos: tuple[str, ...] = SERVOS, shown: bool = False) -> Sweep:
    """Sweeps in both directions; friction and the tendons' seats differ from trial to trial.

    Args:
        reference: the hand; its own tendon friction comes from its `trials`.
        count: trials.
        seed: of the differences and of the camera.
        servos: which are swept.
        shown: draw a progress bar.
    """
    parts = []
    for trial in progress(range(count), "trials", shown):
        rng = np.random.default_rng([seed, trial])
        factor = max(1 + reference.trials.friction_spread * rng.standard_normal(), 0.0)
        settings = replace(
            reference.rig.settings,
            joint_friction=factor * reference.rig.settings.joint_friction,
            tendon_friction=factor * reference.trials.tendon_friction,
            slack=tuple((reference.trials.seat * rng.standard_normal(5)).tolist()),
        )
        rig = replace(reference.rig, settings=settings).with_protocol(both_directions=True)
        parts.append(rig.sweep(rng, trial=trial, servos=servos))
    return concatenate(parts)


def by_joint(record: Sweep, cutoff_hz: float) -> dict[str, JointTrials]:
    """The trials of every joint that was swept, processed as the paper does."""
    return by_joint_of_points(points(processed(record, cutoff_hz)))


def by_joint_of_points(found: Points) -> dict[str, JointTrials]:
    """The trials of every joint, one row a trial, in the order of the points."""
    return {
        JOINTS[joint]: JointTrials(
            _table(found, int(servo), found.servo[:, servo], "flexion")[0],
            _table(found, int(servo), found.joint_pos[:, joint], "flexion"),
            _table(found, int(servo), found.joint_pos[:, joint], "extension"),
        )
        for servo in np.unique(found.swept)
        for joint in joints_of_servo(int(servo))
    }


def _table(found: Points, servo: int, values: Array, phase: str) -> Array:
    rows = (found.swept == servo) & (found.phase == PHASES.index(phase))
    return values[rows].reshape(len(np.unique(found.trial[rows])), -1)


def hysteresis_width(joint: JointTrials) -> Array:
    """Extension less flexion at equal servo angles, averaged over `DRIVEN`, of every trial, shape (trials,) [rad]."""
    share = (joint.servo - joint.servo[0]) / (joint.servo[-1] - joint.servo[0])
    inside = (share >= DRIVEN[0]) & (share <= DRIVEN[1])
    return (joint.extension - joint.flexion)[:, inside].mean(axis=1)


def hysteresis_deg(joints: dict[str, JointTrials]) -> dict[str, Mean]:
    """Width by joint, with its interval over trials [°]."""
    return {name: mean_of(np.degrees(hysteresis_width(joint))) for name, joint in joints.items()}


def spread_deg(joints: dict[str, JointTrials]) -> dict[str, Mean]:
    """Root mean square over the points of the trial-to-trial standard deviation, jackknifed over trials [°]."""
    found = {}
    for name, joint in joints.items():
        whole = _rms_spread(joint.flexion)
        count = len(joint.flexion)
        left = [count * whole - (count - 1) * _rms_spread(np.delete(joint.flexion, trial, axis=0)) for trial in range(count)]
        interval = mean_of(np.degrees(left))
        found[name] = replace(interval, mean=float(np.degrees(whole)), low=max(interval.low, 0.0))
    return found


def _rms_spread(flexion: Array) -> float:
    return float(np.sqrt((flexion.std(axis=0, ddof=1) ** 2).mean()))


def hysteresis_figure(joints: dict[str, JointTrials]) -> Figure:
    """Extension less flexion over the servo's angle, every trial a line."""
    figure = Figure(figsize=(13, 8), layout="constrained")
    for axis, (name, joint) in zip(figure.subplots(3, 5, sharey=True).flat, joints.items(), strict=False):
        width = np.degrees(joint.extension - joint.flexion)
        axis.plot(np.degrees(joint.servo), width.T, color=figures.BLUE, linewidth=0.9, alpha=0.7)
        axis.axhline(0.0, color=figures.GREY, linewidth=0.8)
        axis.set_title(figures.label(name), fontsize=9)
    figure.supxlabel("servo angle [°]")
    figure.supylabel("extension − flexion [°]")
    return figure


def spread_figure(joints: dict[str, JointTrials]) -> Figure:
    """Trial-to-trial standard deviation by joint, with intervals."""
    found = spread_deg(joints)
    figure = Figure(figsize=(11, 4), layout="constrained")
    axis = figure.subplots()
    means = np.array([value.mean for value in found.values()])
    bounds = np.array([[value.low, value.high] for value in found.values()])
    axis.bar(range(len(found)), means, color=figures.BLUE)
    axis.errorbar(range(len(found)), means, np.abs(bounds.T - means), fmt="none", color="black", capsize=3)
    axis.set_xticks(range(len(found)), [figures.label(name) for name in found], rotation=35)
    axis.set_ylabel("trial-to-trial standard deviation [°]")
    return figure
