"""Dynamic tracking: sine and minimum-jerk commands at several rates, with lag and error of every joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from matplotlib.figure import Figure

from hpac_gym.model import HPAC, JOINTS, SERVO_INDEX, joints_from_synergy, servo_from_synergy, stream_command
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.sim import SimHand, World
from hpac_gym.study import figures
from hpac_gym.study.accuracy import EVALUATED
from hpac_gym.study.intervals import Mean, mean_of
from hpac_gym.study.reference import Reference
from hpac_gym.study.rig import THUMB_CLEAR

RATES_HZ = (0.25, 0.5, 1.0, 2.0)
CONTROL_HZ = 20.0
SAMPLE_HZ = 80.0
MIDDLE, AMPLITUDE = 0.5, 0.3
"""Of the driven joints' range."""
WARM_UP = 1.0
"""Periods before the error counts."""
PERIODS = 3.0
LONGEST_LAG = 0.3  # s, that is looked for

Profile = Callable[[Array], Array]


def sine(phase: Array) -> Array:
    """−1…1 over one period of `phase`, shape kept."""
    return np.sin(2 * np.pi * phase)


def minimum_jerk(phase: Array) -> Array:
    """From −1 to 1 and back in one period, each half 10s³ − 15s⁴ + 6s⁵."""
    phase = np.asarray(phase) % 1.0
    s = np.where(phase < 0.5, 2 * phase, 2 - 2 * phase)
    return 2 * (10 * s**3 - 15 * s**4 + 6 * s**5) - 1


PROFILES: dict[str, Profile] = {"sine": sine, "minimum_jerk": minimum_jerk}


@dataclass(frozen=True, slots=True)
class Track:
    """One run: where the joints should be and where the camera saw them."""

    time: Array
    """Shape (n,) [s]."""
    wanted: Array
    """The elastic model's joint angles of the commanded profile, shape (n, 15) [rad]."""
    measured: Array
    """Shape (n, 15) [rad]."""


def synergy_of(profile: Profile, rate_hz: float, time: Array) -> Array:
    """The commanded synergies: fingers and thumb about half of their range, CMC at rest where the thumb is clear."""
    span = HPAC.synergy_max - HPAC.synergy_min
    synergy = HPAC.synergy_min + (MIDDLE + AMPLITUDE * profile(rate_hz * np.asarray(time)))[..., None] * span
    synergy[..., SERVO_INDEX["thumb_cmc"]] = THUMB_CLEAR
    return synergy


def track(reference: Reference, profile: Profile, rate_hz: float, rng: np.random.Generator) -> Track:
    """Stream a profile to the reference hand at the control rate and watch it."""
    settings = replace(
        reference.rig.settings,
        tendon_friction=reference.trials.tendon_friction,
        servo=replace(reference.rig.settings.servo, lag=reference.servo_lag),
    )
    control, sample = 1 / CONTROL_HZ, 1 / SAMPLE_HZ
    steps = int(np.ceil((WARM_UP + PERIODS) / rate_hz * CONTROL_HZ))
    measured = []
    with World(reference.rig.world) as world:
        hand = SimHand(world, reference.rig.hand, settings, visuals=False)
        servo = servo_from_synergy(synergy_of(profile, rate_hz, np.array(0.0)))
        hand.reset(synergy_of(profile, rate_hz, np.array(0.0)))
        for step in range(steps):
            target = servo_from_synergy(synergy_of(profile, rate_hz, np.array((step + 1) * control)))
            command = stream_command(servo, target, control)
            servo = command.servo
            hand.command(command)
            for _ in range(round(SAMPLE_HZ / CONTROL_HZ)):
                hand.step(sample)
                measured.append(hand.joint_pos)
    time = sample * np.arange(1, len(measured) + 1)
    seen = np.array(measured) + rng.normal(0.0, reference.rig.camera.noise, (len(measured), len(JOINTS)))
    counts = time > WARM_UP / rate_hz
    return Track(time[counts], joints_from_synergy(synergy_of(profile, rate_hz, time[counts])), seen[counts])


def lag(time: Array, wanted: Array, measured: Array) -> float:
    """The delay that makes a wanted course fit a measured one best in least squares, offset aside [s]."""
    delays = np.arange(0.0, LONGEST_LAG, 2e-3)
    errors = []
    inside = time > time[0] + LONGEST_LAG
    for delay in delays:
        difference = measured[inside] - np.interp(time[inside] - delay, time, wanted)
        errors.append(difference.var())
    best = int(np.argmin(errors))
    if 0 < best < len(delays) - 1:
        before, here, after = errors[best - 1 : best + 2]
        return float(delays[best] + 1e-3 * (before - after) / (before - 2 * here + after))
    return float(delays[best])


@dataclass(frozen=True, slots=True)
class Tracked:
    """Lag and error of the nine joints at one rate."""

    profile: str
    rate_hz: float
    lag_s: dict[str, Mean]
    """By joint, and `mean` over the joints."""
    rms_deg: dict[str, Mean]
    """By joint, and `mean` over the joints."""


def run_tracking(
    reference: Reference, count: int, seed: int, rates_hz: tuple[float, ...] = RATES_HZ, shown: bool = False
) -> list[Tracked]:
    """Both profiles at every rate, several runs each.

    Args:
        reference: the hand, with its tendon friction and servo lag.
        count: runs; friction and the camera's noise differ.
        seed: of both.
        rates_hz: of the profiles' periods.
        shown: draw a progress bar.
    """
    found = []
    for name, rate_hz in progress([(name, rate) for name in PROFILES for rate in rates_hz], "tracking", shown):
        lags, errors = {joint: [] for joint in EVALUATED}, {joint: [] for joint in EVALUATED}
        for run in range(count):
            rng = np.random.default_rng([seed, run])
            factor = max(1 + reference.trials.friction_spread * rng.standard_normal(), 0.0)
            trials = replace(reference.trials, tendon_friction=factor * reference.trials.tendon_friction)
            seen = track(replace(reference, trials=trials), PROFILES[name], rate_hz, rng)
            for joint in EVALUATED:
                column = JOINTS.index(joint)
                lags[joint].append(lag(seen.time, seen.wanted[:, column], seen.measured[:, column]))
                error = seen.measured[:, column] - seen.wanted[:, column]
                errors[joint].append(np.degrees(np.sqrt(np.mean(error**2))))
        found.append(Tracked(name, rate_hz, _means(lags), _means(errors)))
    return found


def _means(runs: dict[str, list[float]]) -> dict[str, Mean]:
    return {**{name: mean_of(values) for name, values in runs.items()}, "mean": mean_of(np.mean(list(runs.values()), axis=0))}


def tracking_figure(found: list[Tracked]) -> Figure:
    """Lag and RMS error of the nine joints over the rate of the command."""
    figure = Figure(figsize=(10, 7), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    for column, profile in enumerate(PROFILES):
        runs = [item for item in found if item.profile == profile]
        rates = [item.rate_hz for item in runs]
        for joint in EVALUATED:
            axes[0, column].plot(rates, [1e3 * item.lag_s[joint].mean for item in runs], "o-", label=figures.label(joint))
            axes[1, column].plot(rates, [item.rms_deg[joint].mean for item in runs], "o-")
        axes[0, column].set_title(profile.replace("_", " "))
        axes[1, column].set_xlabel("rate of the command [Hz]")
        axes[1, column].set_xscale("log", base=2)
        axes[1, column].set_xticks(rates, [f"{rate:g}" for rate in rates])
    axes[0, 0].set_ylabel("lag [ms]")
    axes[1, 0].set_ylabel("RMS error [°]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside right center", frameon=False, fontsize=8)
    return figure
