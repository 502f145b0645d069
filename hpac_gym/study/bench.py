"""The test bench: how a servo is swept, what the camera makes of the joints, and records of hands in metal.

`rig.Rig.sweep` records the same of a hand in the physics engine; whatever makes a `Sweep` of a hand can stand in for either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.study.population import Built
from hpac_gym.study.quasistatic import follow
from hpac_gym.study.record import PHASES, Sweep, concatenate

THUMB_CLEAR = 1.2
"""CMC angle at which the thumb can bend over its whole range and touches neither finger nor palm [rad]."""
_STEPS = 2
"""Quasi-static steps from one sampling point to the next."""
_REST, _FLEXION, _EXTENSION = range(len(PHASES))


def rest_pose(swept: str) -> Array:
    """Servo angles from which a servo is swept: open, but the thumb clear of the index when it bends, shape (6,) [rad]."""
    pose = np.zeros(len(SERVOS))
    if swept == "thumb_mp":
        pose[SERVO_INDEX["thumb_cmc"]] = THUMB_CLEAR
    return pose


@dataclass(frozen=True, slots=True)
class JointCamera:
    """What measures the joint angles: one sample a frame, with white noise and a slow drift of each joint.

    The other errors are common to all joints of a frame, or of the whole record, and zero by default.

    Raises:
        ParameterError: A rate or time that is not positive, a negative deviation, or a share of outliers beyond 1.
    """

    rate_hz: float = 20.0
    noise: float = np.deg2rad(0.1)
    """Standard deviation of a sample [rad]."""
    drift: float = np.deg2rad(0.2) / 60
    """Standard deviation of the joints' drift rates [rad/s]."""
    common_scale: float = 0.0
    """Standard deviation of the relative error of every angle of a record: a camera whose calibration is off."""
    common_wander: float = 0.0
    """Standard deviation of an error that all joints of a frame share [rad]."""
    wander_time: float = 3.0
    """Time over which that error forgets itself [s]."""
    outliers: float = 0.0
    """Share of samples in which a marker was mistaken: anything from −0.5 to 2 rad."""

    def __post_init__(self) -> None:
        errors = (self.noise, self.drift, self.common_scale, self.common_wander)
        if not (self.rate_hz > 0 and self.wander_time > 0 and min(errors) >= 0 and 0 <= self.outliers <= 1):
            raise ParameterError(
                f"camera: rate_hz = {self.rate_hz} Hz and wander_time = {self.wander_time} s must be greater than 0, noise = "
                f"{self.noise} rad, drift = {self.drift} rad/s, common_scale = {self.common_scale} and common_wander = "
                f"{self.common_wander} rad not below it, outliers = {self.outliers} a share"
            )

    def seen(self, joint_pos: Array, time: Array, rng: np.random.Generator) -> Array:
        """What the camera makes of true angles, shape (n, joints) [rad], at times (n,) [s]."""
        drift = rng.normal(0.0, self.drift, joint_pos.shape[1]) * time[:, None]
        seen = joint_pos + drift + rng.normal(0.0, self.noise, joint_pos.shape)
        if self.common_scale:
            seen = seen * (1 + self.common_scale * rng.standard_normal())
        if self.common_wander:
            seen = seen + self._wander(time, rng)[:, None]
        if self.outliers:
            seen = np.where(rng.random(seen.shape) < self.outliers, rng.uniform(-0.5, 2.0, seen.shape), seen)
        return seen

    def _wander(self, time: Array, rng: np.random.Generator) -> Array:
        """A first-order Gauss–Markov process, shape (n,) [rad]."""
        kept = np.exp(-np.diff(time, prepend=time[0]) / self.wander_time)
        fresh = self.common_wander * rng.standard_normal(len(time))
        wander = np.empty(len(time))
        level = fresh[0]
        for i, (share, new) in enumerate(zip(kept, fresh, strict=True)):
            level = share * level + np.sqrt(1 - share**2) * new
            wander[i] = level
        return wander


@dataclass(frozen=True, slots=True)
class Protocol:
    """How a servo is swept: rest, K points one after the other, back to rest.

    Raises:
        ParameterError: Fewer than two points, a hold that leaves no time to move, or a negative rest.
    """

    points: int = 31
    """K, over the servo's admissible range, both ends included."""
    seconds_per_point: float = 1.5
    hold: float = 0.5
    """The last part of a point, in which the servo stands still and the points are taken [s]."""
    rest: float = 2.0
    """Before and after: the tendon slack, the digit laid against its stops [s]."""
    both_directions: bool = False
    """Take points on the way back too, at the same angles."""

    def __post_init__(self) -> None:
        if not (isinstance(self.points, int) and self.points >= 2):
            raise ParameterError(f"protocol: points = {self.points!r} must be a whole number of at least 2")
        if not (0 < self.hold < self.seconds_per_point and self.rest >= 0):
            raise ParameterError(
                f"protocol: hold = {self.hold} s must lie between 0 s and seconds_per_point = {self.seconds_per_point} s, "
                f"and rest = {self.rest} s not be negative"
            )


CAMERA, PROTOCOL = JointCamera(), Protocol()


def metal_sweeps(
    built: Sequence[Built],
    seed: int,
    camera: JointCamera = CAMERA,
    protocol: Protocol = PROTOCOL,
    servos: tuple[str, ...] = SERVOS,
    base: Hand = HPAC,
) -> list[Sweep]:
    """Records of hands in metal: the rest poses and the held samples of every point; nothing is recorded in motion.

    Args:
        built: the hands.
        seed: of the camera; hand i of a seed has the same camera for any number of hands.
        camera: what measures.
        protocol: how the servos are swept.
        servos: which ones.
        base: the hand that the commands are made for.
    """
    parts: list[list[Sweep]] = [[] for _ in built]
    for name in servos:
        swept = SERVOS.index(name)
        up = np.linspace(base.servo_min[swept], base.servo_max[swept], protocol.points)
        angles = np.concatenate([up, up[::-1]]) if protocol.both_directions else up
        course = metal_course(built, swept, angles)
        for number in range(len(built)):
            rng = np.random.default_rng([seed, number, swept])
            parts[number].append(_segment(swept, angles, course[number], rng, camera, protocol))
    return [concatenate(segments) for segments in parts]


def metal_course(built: Sequence[Built], swept: int, angles: Array) -> Array:
    """True joint angles of hands in metal along angles of one servo from the open hand, shape (hands, k, 15) [rad]."""
    course = np.zeros((len(built), len(angles), len(JOINTS)))
    if SERVOS[swept] == "thumb_cmc":
        course[:, :, JOINT_INDEX["thumb_cmc"]] = np.array([item.hand.cmc_gain for item in built])[:, None] * angles
        return course
    name = list(HPAC.digits)[swept]
    knots = np.arange(len(angles))
    path = np.interp(np.arange(0, len(angles) - 1 + 0.5 / _STEPS, 1 / _STEPS), knots, angles)
    digits, metal = [item.hand.digits[name] for item in built], [item.metal[swept] for item in built]
    found = follow(digits, metal, np.repeat(path[:, None], len(built), axis=1))[::_STEPS]
    course[:, :, [JOINT_INDEX[joint] for joint in digits[0].joints]] = found.transpose(1, 0, 2)
    return course


def _segment(
    swept: int, angles: Array, course: Array, rng: np.random.Generator, camera: JointCamera, protocol: Protocol
) -> Sweep:
    """A record's rows of one servo: rest, the held samples of each angle, rest."""
    rest = round(protocol.rest * camera.rate_hz)
    held = max(round(protocol.hold * camera.rate_hz) - 1, 1)
    pose = rest_pose(SERVOS[swept])
    still = np.zeros(len(JOINTS))
    still[JOINT_INDEX["thumb_cmc"]] = pose[SERVO_INDEX["thumb_cmc"]]
    count = len(angles)
    start = np.arange(rest) / camera.rate_hz
    ends = protocol.rest + protocol.seconds_per_point * np.arange(1, count + 1)
    holds = (ends[:, None] - np.arange(held)[::-1] / camera.rate_hz).ravel()
    time = np.concatenate([start, holds, holds[-1] + (1 + np.arange(rest)) / camera.rate_hz])
    back = count // 2 if protocol.both_directions else count
    ways = np.where(np.arange(count) < back, _FLEXION, _EXTENSION)
    numbers = np.where(ways == _FLEXION, np.arange(count), count - 1 - np.arange(count))
    phase = np.concatenate([np.full(rest, _REST), np.repeat(ways, held), np.full(rest, _REST)])
    point = np.concatenate([np.full(rest, -1), np.repeat(numbers, held), np.full(rest, -1)])
    servo, joint_pos = np.tile(pose, (len(time), 1)), np.tile(still, (len(time), 1))
    servo[phase != _REST, swept] = np.repeat(angles, held)
    measured = [JOINT_INDEX[name] for name in JOINTS if HPAC.servo_of_joint[JOINT_INDEX[name]] == swept]
    joint_pos[np.ix_(phase != _REST, measured)] = np.repeat(course[:, measured], held, axis=0)
    joint_pos = camera.seen(joint_pos, time, rng)
    return Sweep(np.zeros(len(time), dtype=int), np.full(len(time), swept), phase, point, time, servo, joint_pos)
