"""Dynamic tracking: sine and minimum-jerk commands at several rates, open loop and with the camera
in the loop.

The camera is too slow and delayed for direct feedback of the joint angles: instead the loop
estimates a lag and an offset for each direction, and shifts the command by them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.populations import NINE
from experiments.results import Interval, Part, mean_of
from experiments.sweep import Reference
from hpac_gym.calibration.accuracy import EVALUATED
from hpac_gym.calibration.record import THUMB_CLEAR
from hpac_gym.figures import GREEN, RED, new_figure
from hpac_gym.model import (
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVO_INDEX,
    Array,
    joints_from_synergy,
    servo_from_synergy,
    stream_command,
)
from hpac_gym.model.command import minimum_jerk
from hpac_gym.output import markdown
from hpac_gym.physics.stand import UPRIGHT, HandOnStand
from hpac_gym.progress import progress

CONTROL_HZ = 20.0
RATES_HZ = (0.25, 0.5, 1.0)
MIDDLE = 0.5
AMPLITUDE = 0.3
"""Mean and amplitude of the profile as shares of the driven joints' range."""
WARM_UP = 3.0
"""Periods before the error counts, during which the camera's loop learns."""
PERIODS = 3.0
LONGEST_LAG = 0.3  # s, upper bound of the estimate
SAMPLES = 4  # camera samples per control period

Profile = Callable[[Array], Array]


def sine(phase: Array) -> Array:
    """Sine of range −1…1 with period 1 in `phase`, of the same shape."""
    return np.sin(2 * np.pi * phase)


def back_and_forth(phase: Array) -> Array:
    """Motion from −1 to 1 and back in one period, each half a minimum-jerk move."""
    phase = np.asarray(phase) % 1.0
    return 2 * minimum_jerk(np.where(phase < 0.5, 2 * phase, 2 - 2 * phase)) - 1


PROFILES: dict[str, Profile] = {"sine": sine, "minimum_jerk": back_and_forth}


class Track(NamedTuple):
    """One run: times (n,) [s], the elastic model's joint angles of the profile and the measured
    ones, both (n, 15) [rad].
    """

    time: Array
    wanted: Array
    measured: Array


def synergy_of(profile: Profile, rate_hz: float, time: Array | float) -> Array:
    """The commanded synergies: fingers and thumb around half of their range, the CMC constant where
    the thumb is clear.
    """
    span = HPAC.synergy_max - HPAC.synergy_min
    synergy = (
        HPAC.synergy_min
        + (MIDDLE + AMPLITUDE * profile(rate_hz * np.asarray(time)))[..., None] * span
    )
    synergy[..., SERVO_INDEX["thumb_cmc"]] = THUMB_CLEAR
    return synergy


@dataclass(slots=True)
class Observer:
    """Correction of the command, learned from the camera: a lag, and an offset of every digit for
    each direction.

    A digit's error is the average over its joints in units of its root joint. It is modelled as
    offset − lag · rate and fitted by normalised least mean squares; the lag is common to all
    digits."""

    lag: float = 0.0
    """Estimated lag of the hand [s]."""
    offset: Array = field(default_factory=lambda: np.zeros((2, 5)))
    """Offset of each digit in flexion and in extension, shape (2, 5) [rad]."""
    lag_gain: float = 0.05
    offset_gain: float = 0.1
    """Share of an error that is corrected per frame."""

    def update(self, error: Array, rate: Array) -> None:
        """Learn from one frame: measured minus desired angles [rad] and desired rates [rad/s] of
        the digits, shape (5,).
        """
        flexing = (rate < 0).astype(int)
        power = float((rate**2).mean())
        if power > 1e-4:
            self.lag = float(
                np.clip(
                    self.lag - self.lag_gain * (error * rate).mean() / max(power, 0.05),
                    0.0,
                    LONGEST_LAG,
                )
            )
        self.offset[flexing, np.arange(len(error))] += self.offset_gain * error

    def correction(self, rate: Array) -> Array:
        """Offsets to subtract from the command at the given rates, shape (5,) [rad]."""
        return self.offset[(rate < 0).astype(int), np.arange(len(rate))]


def root_error(seen: Array, wanted: Array) -> Array:
    """Error of every digit in units of its root joint, averaged over its joints, from shape (15,)
    to (5,) [rad].
    """
    error = (seen - wanted) / HPAC.elastic_ratio
    return np.array(
        [
            error[[JOINT_INDEX[name] for name in digit.joints]].mean()
            for digit in HPAC.digits.values()
        ]
    )


def track(
    reference: Reference,
    profile: Profile,
    rate_hz: float,
    rng: np.random.Generator,
    closed: bool = False,
) -> Track:
    """Stream a profile to the reference hand, with its tendon friction and servo lag, and measure
    it.

    In closed loop, the camera's frame of the previous control period corrects the command. `rng`
    makes the camera's noise."""
    rig = reference.rig
    observer = Observer()
    servo_settings = replace(rig.settings.servo, lag=reference.servo_lag)
    settings = replace(
        rig.settings, tendon_friction=reference.tendon_friction, servo=servo_settings
    )
    # All five digits move at once; thumb and index would collide.
    world = replace(rig.world, collisions=False)
    period = 1 / CONTROL_HZ
    steps = int(np.ceil((WARM_UP + PERIODS) / rate_hz * CONTROL_HZ))
    noise = rng.normal(0.0, rig.camera.noise, (steps * SAMPLES, len(JOINTS)))

    synergy = partial(synergy_of, profile, rate_hz)

    def rate(time: float) -> Array:
        return (synergy(time + 0.01) - synergy(time - 0.01))[:-1] / 0.02

    sim = HandOnStand(rig.hand, settings, world, UPRIGHT, engine=rig.engine)
    sim.reset(synergy(0.0))
    servo = servo_from_synergy(synergy(0.0))
    seen = []
    for step in range(steps):
        now = (step - 1) * period
        then = (step + 1) * period
        if closed and step > 1:  # the frame is one control period old
            observer.update(
                root_error(seen[-1 - SAMPLES], joints_from_synergy(synergy(now))), rate(now)
            )
        wanted = synergy(then + observer.lag)
        wanted[:-1] -= observer.correction(rate(then + observer.lag))
        target = servo_from_synergy(np.clip(wanted, HPAC.synergy_min, HPAC.synergy_max))
        servo = stream_command(servo, target, period).servo
        sim.command(servo, period)
        for _ in range(SAMPLES):
            sim.step(period / SAMPLES)
            seen.append(sim.joint_pos + noise[len(seen)])
    sim.close()
    time = period / SAMPLES * np.arange(1, len(seen) + 1)
    counts = time > WARM_UP / rate_hz
    return Track(time[counts], joints_from_synergy(synergy(time[counts])), np.array(seen)[counts])


def lag(time: Array, wanted: Array, measured: Array) -> float:
    """Least-squares delay of a measured motion relative to the desired one, ignoring an offset
    [s].
    """
    delays = np.arange(0.0, LONGEST_LAG, 2e-3)
    inside = time > time[0] + LONGEST_LAG
    errors = [
        np.var(measured[inside] - np.interp(time[inside] - delay, time, wanted)) for delay in delays
    ]
    best = int(np.argmin(errors))
    if not 0 < best < len(delays) - 1:
        return float(delays[best])
    before, here, after = errors[best - 1 : best + 2]
    return float(delays[best] + 1e-3 * (before - after) / (before - 2 * here + after))


@dataclass(frozen=True, slots=True)
class Tracked:
    """Lag and error of the nine joints at one rate."""

    profile: str
    rate_hz: float
    closed: bool
    """Whether the camera was in the loop."""
    lag_ms: Interval
    """Lag, mean over the joints [ms]."""
    rms_deg: dict[str, Interval]
    """RMS error by joint, and `mean` over the joints [°]."""


def run_tracking(
    reference: Reference, name: str, rate_hz: float, closed: bool, count: int, seed: int
) -> Tracked:
    """Several runs of one of the `PROFILES` with different friction and camera noise."""
    lags, errors = np.empty((2, len(EVALUATED), count))
    for run in range(count):
        rng = np.random.default_rng([seed, run])
        factor = max(1 + reference.friction_spread * rng.standard_normal(), 0.0)
        rubbing = replace(reference, tendon_friction=factor * reference.tendon_friction)
        seen = track(rubbing, PROFILES[name], rate_hz, rng, closed)
        pairs = [(seen.wanted[:, joint], seen.measured[:, joint]) for joint in NINE]
        lags[:, run] = [lag(seen.time, *pair) for pair in pairs]
        errors[:, run] = [np.degrees(np.sqrt(np.mean((m - w) ** 2))) for w, m in pairs]
    table = zip((*EVALUATED, "mean"), (*errors, errors.mean(axis=0)), strict=True)
    rms = {joint: mean_of(values) for joint, values in table}
    return Tracked(name, rate_hz, closed, mean_of(1e3 * lags.mean(axis=0)), rms)


def tracking(
    reference: Reference, count: int, seed: int, rates_hz: Sequence[float] = RATES_HZ
) -> Part:
    """Both profiles at every rate, open loop and closed, several runs each."""
    jobs = [
        (name, rate, closed) for name in PROFILES for rate in rates_hz for closed in (False, True)
    ]
    runs = [run_tracking(reference, *job, count, seed) for job in progress(jobs, "tracking")]
    body = [
        (
            item.profile.replace("_", " "),
            f"{item.rate_hz:g}",
            "camera at 20 Hz" if item.closed else "open",
            f"{item.lag_ms:.1f}",
            item.rms_deg["mean"],
        )
        for item in runs
    ]
    title = (
        f"## Tracking, mean over the nine joints: {count} runs, seed {seed}; mean and 95 % interval"
    )
    made = markdown(("command", "rate [Hz]", "loop", "lag [ms]", "RMS error [°]"), body)
    caption = f"reference hand, {count} runs, seed {seed}"
    return Part(f"{title}\n\n{made}\n", runs, {"tracking": tracking_figure(runs)}, caption)


def tracking_figure(found: list[Tracked]) -> Figure:
    """Figure of the RMS error of the nine joints over the rate of the command, in open and closed
    loop.
    """
    figure = new_figure(10, 4.5)
    axes = figure.subplots(1, len(PROFILES), sharey=True)
    for axis, profile in zip(axes, PROFILES, strict=True):
        for closed, color, name in (
            (False, RED, "open loop"),
            (True, GREEN, "camera in the loop, 20 Hz"),
        ):
            runs = [item for item in found if item.profile == profile and item.closed == closed]
            rates = [item.rate_hz for item in runs]
            joints = [[item.rms_deg[joint].middle for joint in EVALUATED] for item in runs]
            means = [item.rms_deg["mean"].middle for item in runs]
            axis.plot(rates, joints, "-", color=color, alpha=0.25)
            axis.plot(rates, means, "o-", color=color, linewidth=2, label=name)
        axis.set_title(profile.replace("_", " "), fontsize=10)
        axis.set_xlabel("rate of the command [Hz]")
        axis.set_xscale("log", base=2)
        axis.set_yscale("log")
        axis.set_xticks(rates, [f"{rate:g}" for rate in rates])
    axes[0].set_ylabel("RMS error [°], nine joints pale, mean bold")
    axes[0].legend(frameon=False)
    return figure
