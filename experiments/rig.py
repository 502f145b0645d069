"""The test rig: a simulated hand in a stand, a camera that measures its joints, and the servo
sweep.

The stand orients the hand so that the swept digit flexes in a horizontal plane: its weight loads
the hinges, not the tendons."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from experiments.bench import CAMERA, PROTOCOL, JointCamera
from experiments.quasistatic import Built, softened
from hpac_gym.body.geometry import link_poses, load_geometry
from hpac_gym.calibration.processing import points
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
from hpac_gym.model import HPAC, JOINTS, SERVO_INDEX, SERVOS, Array, Hand
from hpac_gym.physics.settings import HandSettings, ServoSettings, WorldSettings
from hpac_gym.physics.simulation import is_installed
from hpac_gym.physics.stand import HAND, WORLD, HandOnStand
from hpac_gym.progress import progress

ENGINE = "pybullet" if is_installed("pybullet") else "mujoco"
"""PyBullet where it is installed: it has friction that grows with the tendons' load."""

NEAR_STOP = np.deg2rad(0.3)
"""In a physics engine, a joint this close to its stop may rest at it [rad]."""


def settings_of(
    joint_friction: float, dead_band: float, tendon_friction: float = 0.0
) -> HandSettings:
    """The rig's hand with friction [N·m, share of the load] and servos with a dead band [rad]."""
    return replace(
        HAND,
        joint_friction=joint_friction,
        tendon_friction=tendon_friction,
        servo=ServoSettings(dead_band=dead_band),
    )


def upright(joint: str) -> Array:
    """Orientation of the stand that makes a driven joint's axis vertical, quaternion xyzw, shape
    (4,).
    """
    digit = load_geometry().digit(joint.split("_")[0])
    names = [phalanx.joint for phalanx in digit.phalanges]
    root = rest_pose(joint)[SERVO_INDEX["thumb_cmc"]]
    _, rotation = link_poses(digit, np.array([root, 0.0, 0.0]))[names.index(joint)]
    x, y, z = rotation @ digit.phalanges[names.index(joint)].axis
    quaternion = np.array([y, -x, 0.0, 1.0 + z])  # the shortest rotation onto +z
    return quaternion / np.linalg.norm(quaternion)


@dataclass(frozen=True, slots=True)
class Rig:
    """A simulated hand with its camera and sweep protocol."""

    hand: Hand = HPAC
    settings: HandSettings = HAND
    camera: JointCamera = CAMERA
    protocol: Protocol = PROTOCOL
    world: WorldSettings = WORLD
    servo_zero: tuple[float, ...] = (0.0,) * len(SERVOS)
    """Angle of each servo's horn at the command 0 [rad]; at rest the tendons are slack
    nevertheless.
    """
    engine: str = ENGINE
    """Name of the physics engine."""

    def sweep(
        self,
        rng: np.random.Generator,
        trial: int = 0,
        servos: tuple[str, ...] = SERVOS,
        label: str = "",
    ) -> Sweep:
        """Sweep one servo after the other over the nominal hand's range, the others at rest, and
        record every frame.

        Args:
            rng: generator of the camera's noise.
            trial: trial number of the rows.
            servos: servos to sweep.
            label: label of the progress bar; no bar if empty.
        """
        parts = []
        for name in progress(servos, label, bool(label)):
            sim = HandOnStand(
                self.hand, self.settings, self.world, tuple(upright(name)), engine=self.engine
            )
            parts.append(self._segment(sim, SERVOS.index(name), trial, rng))
            sim.close()
        return concatenate(parts)

    def _segment(self, sim: HandOnStand, swept: int, trial: int, rng: np.random.Generator) -> Sweep:
        period = 1.0 / self.camera.rate_hz
        zero = np.array(self.servo_zero)
        labels = []
        commanded = []
        measured = []

        def rest() -> None:
            # Reset against its stops, which friction would prevent it from reaching.
            sim.reset(rest_pose(SERVOS[swept]))
            record(self.protocol.rest, REST)

        def record(seconds: float, phase: int, point: int = -1) -> None:
            for _ in range(round(seconds / period)):
                sim.step(period)
                labels.append((phase, point))
                commanded.append(sim.commanded - zero * (phase != REST))
                measured.append(sim.joint_pos)

        def go_to(angle: float, phase: int, point: int) -> None:
            target = rest_pose(SERVOS[swept])
            target[swept] = angle
            moving = self.protocol.seconds_per_point - self.protocol.hold
            sim.command(target + zero, moving)
            record(moving, phase)
            record(self.protocol.hold, phase, point)
            # So that the point's samples are symmetric about the middle of the hold.
            labels[-1] = (phase, -1)

        angles = np.linspace(HPAC.servo_min[swept], HPAC.servo_max[swept], self.protocol.points)
        rest()
        for point, angle in enumerate(angles):
            go_to(angle, FLEXING, point)
        if self.protocol.both_directions:
            for point, angle in reversed(list(enumerate(angles))):
                go_to(angle, EXTENDING, point)
        else:
            record(self.protocol.hold, EXTENDING)  # the extension starts well after the last point
            go_to(angles[0], EXTENDING, -1)
        rest()

        count = len(labels)
        time = period * np.arange(1, count + 1)
        joint_pos = self.camera.seen(np.array(measured), time, rng)
        numbers = (np.full(count, trial), np.full(count, swept), *np.array(labels).T)
        return Sweep(*numbers, time, np.array(commanded), joint_pos)

    def with_protocol(self, **changes: object) -> Rig:
        """The same rig with another protocol."""
        return replace(self, protocol=replace(self.protocol, **changes))

    def seen_and_true(self, camera: JointCamera, seed: int) -> tuple[Sweep, Array, Array]:
        """Sweep the five digits once before a camera.

        Returns:
            The record; servo angles, shape (points, 6), and true joint angles at its sampling
            points, shape (points, 15) [rad].
        """
        true = replace(self, camera=JointCamera(noise=0.0, drift=0.0)).sweep(
            np.random.default_rng(seed), servos=SERVOS[:-1]
        )
        seen = true.joint_pos.copy()
        held = points(true)
        for rows in true.segments():
            seen[rows] = camera.seen(
                seen[rows], true.time[rows], np.random.default_rng([seed, int(rows[0])])
            )
        servo, joint_pos = (
            np.zeros((self.protocol.points, len(names))) for names in (SERVOS, JOINTS)
        )
        for column in range(len(SERVOS) - 1):
            swept = held.swept == column
            joints = joints_of_servo(column)
            servo[:, column] = held.servo[swept, column]
            joint_pos[:, joints] = held.joint_pos[swept][:, joints]
        return true.with_joint_pos(seen), servo, joint_pos


def rig_of(built: Built, engine: str = ENGINE) -> Rig:
    """A hand in metal in a physics engine, without guide pins and sliding cable, with Table I's
    stops.

    Friction and dead band of all digits are the first one's. A servo that gives way is a softer
    driving tendon."""
    digits = {}
    for (name, digit), metal in zip(built.hand.digits.items(), built.metal, strict=True):
        first, *others = digit.path_length
        path = (first * 2 / metal.first_segment if others else first, *others)
        digits[name] = replace(digit, path_length=path, drive_stiffness=softened(digit, metal))
    metal = built.metal[0]
    zero = (*(item.servo_zero for item in built.metal), 0.0)
    settings = settings_of(metal.joint_friction, metal.dead_band, metal.tendon_friction)
    return Rig(replace(built.hand, digits=digits), settings, servo_zero=zero, engine=engine)
