"""Hands that lack nothing of what a workshop's hand may have, and sweeps of them.

Own laws and own code: none of the fit's, of `quasistatic`'s or of an engine's. A digit's posture is
tabulated over the angle of its motor in either direction, with hardening tendons, EA/L in both
segments, slack in the loops, pretension, losses at the guides, a sliding return cable, pins, gear
play and soft servos; friction holds a joint between the two tables. Potentiometers bend, servos warm
up, and each sweep has a camera set up anew, whose scale and plane are off. All sizes are chosen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from experiments.bench import PROTOCOL, segment, wander
from experiments.populations import geometry, varied_digit
from hpac_gym.calibration.record import Sweep, concatenate
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVOS, Array, Digit, Hand

SEED = 33_400
"""First seed of the hands; no other experiment uses it."""
CMC = len(SERVOS) - 1
REACH = {
    **geometry(0.03),
    "path_length": 0.03,
    "spring_stiffness": 0.25,
    "tendon_stiffness": 0.25,
    "drive_stiffness": 0.25,
}
"""The parameters are drawn uniformly within these relative deviations from the nominal ones."""
RATE_HZ = 20.0
_GRID = 160  # angles of the root joint at which a digit is tabulated
_ROUNDS = 40
_HALVINGS = 32


@dataclass(frozen=True, slots=True)
class Imperfections:
    """What one digit and its servo have beyond the model's parameters."""

    zero: float
    """Angle of the horn at the command 0, slack included [rad]."""
    servo_stiffness: float
    """[N·m/rad]."""
    play: float
    """Play of the gear, taken up by the tendon's pull [rad]."""
    dead_band: float
    """[rad]."""
    pot: tuple[float, float, float]
    """Bend of the potentiometer: amplitude [rad], waves per radian [rad/rad], phase [rad]."""
    pins: float
    """Radius of the guide pins, negative if the tendon runs round their far side [m]."""
    pretension: float
    """Tension of the return spring with the digit straight [N]."""
    slack: float
    """Slack of every coupling loop [m]."""
    hardening: float
    """Growth of a tendon's stiffness with its stretch [1/m]."""
    capstan: float
    """Share of the drive's tension that its guides take."""
    sliding: float
    """Friction coefficient of the return cable round the joints."""
    joint_friction: float
    """[N·m]."""
    tendon_friction: float
    """Share of the load."""
    stop: tuple[float, ...]
    """[rad]."""


def drawn(rng: np.random.Generator, digit: Digit) -> Imperfections:
    """Imperfections of one digit."""
    return Imperfections(
        zero=np.deg2rad(2.0) * rng.standard_normal(),
        servo_stiffness=rng.uniform(10, 30),
        play=np.deg2rad(rng.uniform(0.1, 0.5)),
        dead_band=rng.uniform(5e-4, 2e-3),
        pot=(np.deg2rad(rng.uniform(0.15, 0.5)), rng.uniform(2, 6), rng.uniform(0, 2 * np.pi)),
        pins=rng.choice((-1, 1)) * rng.uniform(0.3e-3, 1e-3),
        pretension=rng.uniform(0.2, 1.5),
        slack=rng.uniform(0, 5e-5),
        hardening=rng.uniform(0, 300),
        capstan=rng.uniform(0.02, 0.1),
        sliding=rng.uniform(0, 0.08),
        joint_friction=1e-3 * np.exp(0.4 * rng.standard_normal()),
        tendon_friction=0.03 * np.exp(0.4 * rng.standard_normal()),
        stop=tuple(
            HPAC.workspace[joint][1] + np.deg2rad(rng.uniform(0, 3)) for joint in digit.joints
        ),
    )


def tabulated(digit: Digit, more: Imperfections, way: float) -> tuple[Array, Array]:
    """Motor angles (k,) and joint angles (k, joints) [rad] of a slow motion in one direction, +1 or
    −1, with all friction against it.
    """
    radius = np.array(digit.joint_radius)
    stiffness = digit.tendon_stiffness / np.array(digit.path_length)
    count = len(radius)
    root = np.linspace(0.0, more.stop[0], _GRID)
    joint_pos = np.zeros((_GRID, count))
    joint_pos[:, 0] = root
    pull = 1 - way * more.tendon_friction
    lag = 1 + way * more.tendon_friction

    def coupling(segment: int, angles: Array) -> Array:
        stretch = (
            radius[segment] * angles[:, segment] - radius[segment + 1] * angles[:, segment + 1]
        )
        stretch = np.maximum(stretch - more.slack, 0.0)
        return stiffness[segment] * stretch * (1 + more.hardening * stretch)

    def extending(joint: int, angles: Array) -> Array:
        """Torque of friction, return cable and the next segment against flexion [N·m]."""
        tension = more.pretension + digit.spring_stiffness * angles @ radius
        tension = tension * np.exp(way * more.sliding * angles[:, : joint + 1].sum(axis=1))
        after = coupling(joint, angles) if joint < count - 1 else 0.0
        return radius[joint] * lag * (tension + after) + way * more.joint_friction

    for _ in range(_ROUNDS):
        for joint in range(1, count):
            low = np.zeros(_GRID)
            high = np.full(_GRID, more.stop[joint])
            for _ in range(_HALVINGS):
                joint_pos[:, joint] = (low + high) / 2
                flexing = radius[joint] * pull * coupling(joint - 1, joint_pos)
                flexes = flexing > extending(joint, joint_pos)
                low = np.where(flexes, joint_pos[:, joint], low)
                high = np.where(flexes, high, joint_pos[:, joint])
    included = digit.alpha - root
    chord = np.sqrt(digit.d1**2 + digit.d2**2 - 2 * digit.d1 * digit.d2 * np.cos(included))
    arm = digit.d1 * digit.d2 * np.sin(included) / chord - more.pins
    tension = np.maximum(extending(0, joint_pos), 0.0) / (pull * arm)
    at_servo = tension * (1 + way * more.capstan)
    mean = (tension + at_servo) / 2
    stretch = 2 * mean / digit.drive_stiffness
    stretch /= 1 + np.sqrt(1 + 4 * more.hardening * mean / digit.drive_stiffness)
    horn = (digit.rest_chord - chord - more.pins * root + stretch) / digit.servo_radius
    twist = at_servo * digit.servo_radius / more.servo_stiffness
    return np.maximum.accumulate(horn + more.play + twist), joint_pos


@dataclass(frozen=True, slots=True)
class BuiltDigit:
    """A digit with imperfections, as two tables."""

    more: Imperfections
    flexion: tuple[Array, Array]
    extension: tuple[Array, Array]

    def course(self, command: Array, warm: Array) -> Array:
        """Joint angles (k, joints) along a slow path of commands (k,) from the open digit [rad];
        `warm` is the shift of the servo's zero (k,) [rad].
        """
        height, waves, phase = self.more.pot
        motor = command + self.more.zero + warm + height * np.sin(waves * command + phase)
        way = np.sign(np.diff(command, prepend=command[0] - 1e-9))
        motor = motor - way * self.more.dead_band
        least, most = (
            np.stack([np.interp(motor, angles, column) for column in joints.T], axis=1)
            for angles, joints in (self.flexion, self.extension)
        )
        course = np.empty_like(least)
        last = np.zeros(least.shape[1])
        for step in range(len(motor)):
            last = np.minimum(np.maximum(last, least[step]), np.maximum(most[step], least[step]))
            course[step] = last
        return course


@dataclass(frozen=True, slots=True)
class ImperfectHand:
    """A hand with everything missing from the model at once."""

    hand: Hand
    digits: tuple[BuiltDigit, ...]
    cmc: Imperfections

    @classmethod
    def drawn(cls, seed: int) -> ImperfectHand:
        """The hand of a seed."""
        rng = np.random.default_rng([SEED, seed])
        hand = replace(
            HPAC,
            digits={
                name: varied_digit(digit, REACH, partial(rng.uniform, -1.0, 1.0))
                for name, digit in HPAC.digits.items()
            },
            cmc_gain=HPAC.cmc_gain * (1 + 0.01 * rng.standard_normal()),
        )
        digits = []
        for digit in hand.digits.values():
            more = drawn(rng, digit)
            digits.append(
                BuiltDigit(more, tabulated(digit, more, 1.0), tabulated(digit, more, -1.0))
            )
        return cls(hand, tuple(digits), drawn(rng, hand.digits["thumb"]))

    def course(self, servo: Array, time: Array, session: Session) -> Array:
        """Joint angles (k, 15) along a slow path of servo angles (k, 6) from the open hand [rad]."""
        joint_pos = np.zeros((len(servo), len(JOINTS)))
        for column, (digit, built) in enumerate(
            zip(self.hand.digits.values(), self.digits, strict=True)
        ):
            warm = session.warm[column] * (1 - np.exp(-time / session.warming_s))
            names = [JOINT_INDEX[joint] for joint in digit.joints]
            joint_pos[:, names] = built.course(servo[:, column], warm)
        height, waves, phase = self.cmc.pot
        command = servo[:, CMC]
        horn = command + self.cmc.zero + height * np.sin(waves * command + phase)
        horn += session.warm[CMC] * (1 - np.exp(-time / session.warming_s)) - self.cmc.dead_band
        joint_pos[:, JOINT_INDEX["thumb_cmc"]] = np.maximum(self.hand.cmc_gain * horn, 0.0)
        return joint_pos


@dataclass(frozen=True, slots=True)
class Session:
    """One use of the hand: how its servos warm up, and the camera as it was set up."""

    warm: Array
    """Shift of each servo's zero once it is warm, shape (6,) [rad]."""
    warming_s: float
    scale: float
    """Relative error of the camera's angles."""
    plane: Array
    """Amplitude of the error with sin 2q of a camera that is not square, by servo, shape (6,)
    [rad].
    """
    noise: float
    """Standard deviation of a sample [rad]."""
    rng: np.random.Generator

    @classmethod
    def drawn(cls, seed: int, number: int) -> Session:
        """A hand's session of a number."""
        rng = np.random.default_rng([SEED, seed, 1 + number])
        return cls(
            np.deg2rad(0.3) * rng.standard_normal(len(SERVOS)),
            rng.uniform(60, 400),
            0.003 * rng.standard_normal(),
            np.deg2rad(rng.uniform(-0.3, 0.3, len(SERVOS))),
            np.deg2rad(rng.uniform(0.05, 0.15)),
            rng,
        )

    def seen(self, joint_pos: Array, time: Array, swept: int) -> Array:
        """What the camera makes of true angles (k, 15) at times (k,) [s], the digit in its plane."""
        slow = wander(time, np.deg2rad(0.06), 3.0, self.rng)
        drift = np.deg2rad(0.15) * self.rng.standard_normal(len(JOINTS))
        seen = joint_pos * (1 + self.scale) + self.plane[swept] * np.sin(2 * joint_pos)
        seen = seen + slow[:, None] + drift * ((time - time[0]) / np.ptp(time))[:, None]
        return seen + self.noise * self.rng.standard_normal(seen.shape)


def swept(hand: ImperfectHand, session: Session, both_ways: bool) -> Sweep:
    """The record of one session: every servo in turn, the held frames of its points, and rests with
    slack tendons.
    """
    protocol = replace(PROTOCOL, both_directions=both_ways)

    def one(column: int) -> Sweep:
        return segment(
            column,
            protocol,
            RATE_HZ,
            lambda servo, time, _: hand.course(servo, column * (time[-1] + 10.0) + time, session),
            partial(session.seen, swept=column),
        )

    return concatenate([one(column) for column in range(len(SERVOS))])
