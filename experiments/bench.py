"""The test bench: sweep protocol, camera model, and records of hands in metal (`quasistatic`).

`rig.Rig.sweep` makes the same record of a hand in the physics engine; any other source of a `Sweep`
can replace either."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from experiments.quasistatic import Built, hand_course
from hpac_gym.calibration.protocol import Protocol, rest_pose
from hpac_gym.calibration.record import (
    EXTENDING,
    FLEXING,
    REST,
    Sweep,
    concatenate,
    joints_of_servo,
)
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS
from hpac_gym.model.checks import Array

_STEPS = 2
"""Quasi-static steps per sampling point."""


@dataclass(frozen=True, slots=True)
class JointCamera:
    """Model of a camera that measures the joint angles, with white noise and a slow drift of each
    joint.

    The other errors are common to all joints of a frame or of the record, and zero by default.

    Raises:
        ParameterError: A rate or time is not positive, a deviation is negative, or the share of
            outliers is outside 0…1.
    """

    rate_hz: float = 20.0
    noise: float = np.deg2rad(0.1)
    """Standard deviation of a sample [rad]."""
    drift: float = np.deg2rad(0.2) / 60
    """Standard deviation of the joints' drift rates [rad/s]."""
    common_scale: float = 0.0
    """Standard deviation of the relative scale error of a record, due to camera calibration."""
    common_wander: float = 0.0
    """Standard deviation of a slowly varying error common to all joints of a frame [rad]."""
    wander_time: float = 3.0
    """Correlation time of that error [s]."""
    outliers: float = 0.0
    """Share of samples with a mistaken marker, uniform between −0.5 and 2 rad."""

    def __post_init__(self) -> None:
        errors = (self.noise, self.drift, self.common_scale, self.common_wander)
        if not (
            self.rate_hz > 0
            and self.wander_time > 0
            and min(errors) >= 0
            and 0 <= self.outliers <= 1
        ):
            raise ParameterError(
                f"{self}: rate_hz [Hz], wander_time [s] must be greater than 0, errors at least 0, outliers 0…1"
            )

    def seen(self, joint_pos: Array, time: Array, rng: np.random.Generator) -> Array:
        """Measured angles for true angles of shape (n, joints) [rad] at times (n,) [s]."""
        drift = rng.normal(0.0, self.drift, joint_pos.shape[1]) * time[:, None]
        seen = joint_pos + drift + rng.normal(0.0, self.noise, joint_pos.shape)
        if self.common_scale:
            seen = seen * (1 + self.common_scale * rng.standard_normal())
        if self.common_wander:
            seen = seen + self._wander(time, rng)[:, None]
        if self.outliers:
            seen = np.where(
                rng.random(seen.shape) < self.outliers, rng.uniform(-0.5, 2.0, seen.shape), seen
            )
        return seen

    def _wander(self, time: Array, rng: np.random.Generator) -> Array:
        """A first-order Gauss–Markov process, shape (n,) [rad]."""
        kept = np.exp(-np.diff(time, prepend=time[0]) / self.wander_time)
        wander = self.common_wander * rng.standard_normal(len(time))
        for i in range(1, len(time)):
            wander[i] = kept[i] * wander[i - 1] + np.sqrt(1 - kept[i] ** 2) * wander[i]
        return wander


CAMERA = JointCamera()
PROTOCOL = Protocol()


def metal_sweeps(
    built: Sequence[Built],
    seed: int,
    camera: JointCamera = CAMERA,
    protocol: Protocol = PROTOCOL,
    servos: tuple[str, ...] = SERVOS,
) -> list[Sweep]:
    """Records of hands in metal: the rest poses and the held samples of every point, without
    samples in motion.

    Hand i of a seed has the same camera for any number of hands.
    """
    point = np.arange(protocol.points)
    phase = np.full(protocol.points, FLEXING)
    if protocol.both_directions:
        point = np.concatenate([point, point[::-1]])
        phase = np.repeat([FLEXING, EXTENDING], protocol.points)
    parts: list[list[Sweep]] = [[] for _ in built]
    for name in servos:
        swept = SERVOS.index(name)
        servo = np.zeros((len(point), len(SERVOS)))
        servo[:, swept] = np.linspace(
            HPAC.servo_min[swept], HPAC.servo_max[swept], protocol.points
        )[point]
        course = hand_course(built, servo, _STEPS, [swept])
        for number, joint_pos in enumerate(course):
            rng = np.random.default_rng([seed, number, swept])
            parts[number].append(
                _segment(swept, phase, point, servo[:, swept], joint_pos, rng, camera, protocol)
            )
    return [concatenate(segments) for segments in parts]


def _segment(
    swept: int,
    phase: np.ndarray,
    point: np.ndarray,
    angles: Array,
    joint_pos: Array,
    rng: np.random.Generator,
    camera: JointCamera,
    protocol: Protocol,
) -> Sweep:
    """Rows of one swept servo: rest, the held samples of each angle, rest."""
    rest = round(protocol.rest * camera.rate_hz)
    held = max(round(protocol.hold * camera.rate_hz) - 1, 1)

    def recorded(values: np.ndarray, at_rest: float) -> np.ndarray:
        return np.pad(np.repeat(values, held), rest, constant_values=at_rest)

    ends = protocol.rest + protocol.seconds_per_point * np.arange(1, len(angles) + 1)
    holds = (ends[:, None] - np.arange(held)[::-1] / camera.rate_hz).ravel()
    time = np.concatenate(
        [
            np.arange(rest) / camera.rate_hz,
            holds,
            holds[-1] + (1 + np.arange(rest)) / camera.rate_hz,
        ]
    )
    servo = np.tile(rest_pose(SERVOS[swept]), (len(time), 1))
    measured = np.zeros((len(time), len(JOINTS)))
    measured[:, JOINT_INDEX["thumb_cmc"]] = servo[:, SERVO_INDEX["thumb_cmc"]]
    servo[:, swept] = recorded(angles, 0.0)
    for joint in joints_of_servo(swept):
        measured[:, joint] = recorded(joint_pos[:, joint], 0.0)
    measured = camera.seen(measured, time, rng)
    zeros = np.zeros(len(time), dtype=int)
    return Sweep(
        zeros, zeros + swept, recorded(phase, REST), recorded(point, -1), time, servo, measured
    )
