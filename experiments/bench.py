"""The test bench: sweep protocol, camera model, and records of hands in metal (`quasistatic`).

`rig.Rig.sweep` makes the same record of a hand in the physics engine; any other source of a `Sweep`
can replace either."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from experiments.quasistatic import Built, hand_course
from hpac_gym.calibration.record import (
    EXTENDING,
    FLEXING,
    REST,
    Protocol,
    Sweep,
    concatenate,
    joints_of_servo,
    rest_pose,
)
from hpac_gym.model import HPAC, JOINT_INDEX, JOINTS, SERVO_INDEX, SERVOS, Array

_STEPS = 2
"""Quasi-static steps per sampling point."""


@dataclass(frozen=True, slots=True)
class JointCamera:
    """Model of a camera that measures the joint angles, with white noise and a slow drift of each
    joint.

    The other errors are common to all joints of a frame or of the record, and zero by default.
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

    def seen(self, joint_pos: Array, time: Array, rng: np.random.Generator) -> Array:
        """Measured angles for true angles of shape (n, joints) [rad] at times (n,) [s]."""
        drift = rng.normal(0.0, self.drift, joint_pos.shape[1]) * time[:, None]
        seen = joint_pos + drift + rng.normal(0.0, self.noise, joint_pos.shape)
        if self.common_scale:
            seen = seen * (1 + self.common_scale * rng.standard_normal())
        if self.common_wander:
            slow = wander(time, self.common_wander, self.wander_time, rng)
            seen = seen + slow[:, None]
        if self.outliers:
            seen = np.where(
                rng.random(seen.shape) < self.outliers, rng.uniform(-0.5, 2.0, seen.shape), seen
            )
        return seen


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
    point, _ = _points(protocol)
    parts: list[list[Sweep]] = [[] for _ in built]
    for name in servos:
        swept = SERVOS.index(name)
        servo = np.zeros((len(point), len(SERVOS)))
        servo[:, swept] = _angles(protocol, swept)[point]
        course = hand_course(built, servo, _STEPS, [swept])
        for number, joint_pos in enumerate(course):
            rng = np.random.default_rng([seed, number, swept])
            parts[number].append(
                segment(
                    swept,
                    protocol,
                    camera.rate_hz,
                    lambda servo, time, place, joint_pos=joint_pos: joint_pos[place],
                    partial(camera.seen, rng=rng),
                )
            )
    return [concatenate(segments) for segments in parts]


def segment(
    swept: int,
    protocol: Protocol,
    rate_hz: float,
    course: Callable[[Array, Array, np.ndarray], Array],
    seen: Callable[[Array, Array], Array],
) -> Sweep:
    """Rows of one swept servo: rest, the held samples of each point, rest.

    Args:
        swept: index of the servo.
        protocol: points and times.
        rate_hz: the camera's frames per second.
        course: takes the rows' servo angles (k, 6) [rad], times (k,) [s] and places among the
            points (k,), −1 at rest; returns the joints' true angles (k, 15) [rad].
        seen: takes true angles and times; returns measured angles (k, 15) [rad].
    """
    point, phase = _points(protocol)
    rest = round(protocol.rest * rate_hz)
    held = max(round(protocol.hold * rate_hz) - 1, 1)

    def recorded(values: np.ndarray, at_rest: float) -> np.ndarray:
        return np.pad(np.repeat(values, held), rest, constant_values=at_rest)

    ends = protocol.rest + protocol.seconds_per_point * np.arange(1, len(point) + 1)
    holds = (ends[:, None] - np.arange(held)[::-1] / rate_hz).ravel()
    time = np.concatenate(
        [np.arange(rest) / rate_hz, holds, holds[-1] + (1 + np.arange(rest)) / rate_hz]
    )
    servo = np.tile(rest_pose(SERVOS[swept]), (len(time), 1))
    joint_pos = np.zeros((len(time), len(JOINTS)))
    joint_pos[:, JOINT_INDEX["thumb_cmc"]] = servo[:, SERVO_INDEX["thumb_cmc"]]
    servo[:, swept] = recorded(_angles(protocol, swept)[point], 0.0)
    place = recorded(np.arange(len(point)), -1)
    joints = joints_of_servo(swept)
    joint_pos[:, joints] = np.where(place[:, None] >= 0, course(servo, time, place)[:, joints], 0.0)
    zeros = np.zeros(len(time), dtype=int)
    return Sweep(
        zeros,
        zeros + swept,
        recorded(phase, REST),
        recorded(point, -1),
        time,
        servo,
        seen(joint_pos, time),
    )


def _points(protocol: Protocol) -> tuple[np.ndarray, np.ndarray]:
    """Number and phase of the points in their order."""
    point = np.arange(protocol.points)
    phase = np.full(protocol.points, FLEXING)
    if protocol.both_directions:
        point = np.concatenate([point, point[::-1]])
        phase = np.repeat([FLEXING, EXTENDING], protocol.points)
    return point, phase


def _angles(protocol: Protocol, swept: int) -> Array:
    """Servo angle of every point [rad]."""
    return np.linspace(HPAC.servo_min[swept], HPAC.servo_max[swept], protocol.points)


def wander(
    time: Array, deviation: float, correlation_time: float, rng: np.random.Generator
) -> Array:
    """A first-order Gauss–Markov process at times (n,) [s], with its standard deviation and
    correlation time [s].
    """
    kept = np.exp(-np.diff(time, prepend=time[0]) / correlation_time)
    found = deviation * rng.standard_normal(len(time))
    for i in range(1, len(time)):
        found[i] = kept[i] * found[i - 1] + np.sqrt(1 - kept[i] ** 2) * found[i]
    return found
