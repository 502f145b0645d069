"""The test rig: a simulated hand in a stand, a camera that measures its joints, and the servo sweep.

The stand turns the hand so that the swept digit bends in a horizontal plane: its weight loads the hinges, not the tendons.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, SERVO_INDEX, SERVOS, Hand, ServoCommand
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.sim import Damping, HandSettings, SimHand, World, WorldSettings
from hpac_gym.sim.geometry import link_poses, load_geometry
from hpac_gym.study.record import PHASES, Sweep, concatenate

_REST, _FLEXION, _EXTENSION = range(len(PHASES))


WORLD = WorldSettings(physics_hz=640, error_reduction=0.2)
"""Finer than what ships, so that a hand with twice the tendon stiffness is integrated as well."""

HAND = HandSettings(armature=(1e-3, 3e-4, 3e-4), damping=Damping(0.4, overrun=0.0))
"""At this rate a hand needs less armature to be integrated than what ships has."""

THUMB_CLEAR = 1.2
"""CMC angle at which the thumb can bend over its whole range and touches neither finger nor palm [rad]."""


def rest_pose(swept: str) -> Array:
    """Servo angles from which a servo is swept: open, but the thumb clear of the index when it bends, shape (6,) [rad]."""
    pose = np.zeros(len(SERVOS))
    if swept == "thumb_mp":
        pose[SERVO_INDEX["thumb_cmc"]] = THUMB_CLEAR
    return pose


def upright(joint: str) -> Array:
    """The stand's orientation that puts a driven joint's axis upright, quaternion xyzw, shape (4,)."""
    digit = load_geometry().digit(joint.split("_")[0])
    names = [phalanx.joint for phalanx in digit.phalanges]
    root = rest_pose(joint)[SERVO_INDEX["thumb_cmc"]]
    _, rotation = link_poses(digit, np.array([root, 0.0, 0.0]))[names.index(joint)]
    x, y, z = rotation @ digit.phalanges[names.index(joint)].axis
    quaternion = np.array([y, -x, 0.0, 1.0 + z])  # the shortest turn onto +z
    return quaternion / np.linalg.norm(quaternion)


@dataclass(frozen=True, slots=True)
class JointCamera:
    """What measures the joint angles: one sample a frame, with white noise and a slow drift.

    Raises:
        ParameterError: A rate that is not positive, a negative noise or drift.
    """

    rate_hz: float = 20.0
    noise: float = np.deg2rad(0.1)
    """Standard deviation of a sample [rad]."""
    drift: float = np.deg2rad(0.2) / 60
    """Standard deviation of the joints' drift rates [rad/s]."""

    def __post_init__(self) -> None:
        if not (self.rate_hz > 0 and self.noise >= 0 and self.drift >= 0):
            raise ParameterError(
                f"camera: rate_hz = {self.rate_hz} Hz must be greater than 0, noise = {self.noise} rad and "
                f"drift = {self.drift} rad/s not below it"
            )

    def seen(self, joint_pos: Array, time: Array, rng: np.random.Generator) -> Array:
        """What the camera makes of true angles, shape (n, joints) [rad], at times (n,) [s]."""
        drift = rng.normal(0.0, self.drift, joint_pos.shape[1]) * time[:, None]
        return joint_pos + drift + rng.normal(0.0, self.noise, joint_pos.shape)


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
    """Before and after, the digit laid against its stops [s]."""
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


@dataclass(frozen=True, slots=True)
class Rig:
    """A hand and what measures it."""

    hand: Hand = HPAC
    settings: HandSettings = HAND
    camera: JointCamera = JointCamera()
    protocol: Protocol = Protocol()
    world: WorldSettings = WORLD

    def sweep(
        self, rng: np.random.Generator, trial: int = 0, servos: tuple[str, ...] = SERVOS, label: str = "", base: Hand = HPAC
    ) -> Sweep:
        """Sweep one servo after the other over the range of `base`, the others at rest, and record every frame.

        Args:
            rng: the camera's noise.
            trial: the number that the rows carry.
            servos: which ones.
            label: shown beside the progress bar, none if empty.
            base: the hand that the commands are made for.
        """
        parts = []
        for name in progress(servos, label, bool(label)):
            with World(self.world) as world:
                sim = SimHand(world, self.hand, self.settings, orientation=upright(name), visuals=False)
                parts.append(self._segment(sim, SERVOS.index(name), trial, rng, base))
        return concatenate(parts)

    def _segment(self, sim: SimHand, swept: int, trial: int, rng: np.random.Generator, base: Hand) -> Sweep:
        period = 1.0 / self.camera.rate_hz
        labels, commanded, measured = [], [], []

        def rest() -> None:
            sim.reset(rest_pose(SERVOS[swept]))  # laid against its stops: friction alone would hold it off them
            record(self.protocol.rest, _REST)

        def record(seconds: float, phase: int, point: int = -1) -> None:
            for _ in range(round(seconds / period)):
                sim.step(period)
                labels.append((phase, point))
                commanded.append(sim.servos.commanded)
                measured.append(sim.joint_pos)

        def go_to(angle: float, phase: int, point: int) -> None:
            target = rest_pose(SERVOS[swept])
            target[swept] = angle
            moving = self.protocol.seconds_per_point - self.protocol.hold
            sim.command(ServoCommand(target, moving))
            record(moving, phase)
            record(self.protocol.hold, phase, point)
            labels[-1] = (phase, -1)  # so that the point's samples lie evenly about the middle of the hold

        angles = np.linspace(base.servo_min[swept], base.servo_max[swept], self.protocol.points)
        rest()
        for point, angle in enumerate(angles):
            go_to(angle, _FLEXION, point)
        if self.protocol.both_directions:
            for point, angle in reversed(list(enumerate(angles))):
                go_to(angle, _EXTENSION, point)
        else:
            record(self.protocol.hold, _EXTENSION)  # the way back starts well after the last point
            go_to(angles[0], _EXTENSION, -1)
        rest()

        count = len(labels)
        time = period * np.arange(1, count + 1)
        phase, point = np.array(labels).T
        joint_pos = self.camera.seen(np.array(measured), time, rng)
        return Sweep(np.full(count, trial), np.full(count, swept), phase, point, time, np.array(commanded), joint_pos)

    def with_protocol(self, **changes: object) -> Rig:
        """The same rig with another protocol."""
        return replace(self, protocol=replace(self.protocol, **changes))
