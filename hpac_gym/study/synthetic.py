"""Records of hands at rest in closed form, with a camera's noise: many of them in little time."""

from __future__ import annotations

import numpy as np

from hpac_gym.model import HPAC, SERVOS, Hand
from hpac_gym.study.record import PHASES, Sweep, concatenate
from hpac_gym.study.rig import JointCamera, Protocol, rest_pose
from hpac_gym.study.statics import Friction, settled_joints

_CAMERA, _PROTOCOL = JointCamera(), Protocol()


def synthetic_sweep(
    hand: Hand,
    friction: Friction,
    rng: np.random.Generator,
    camera: JointCamera = _CAMERA,
    protocol: Protocol = _PROTOCOL,
    servos: tuple[str, ...] = SERVOS,
    base: Hand = HPAC,
) -> Sweep:
    """What `Rig.sweep` would record of a hand that settles at once: rest, the held samples of a flexion, rest."""
    return concatenate([_segment(SERVOS.index(name), hand, friction, rng, camera, protocol, base) for name in servos])


def _segment(
    swept: int, hand: Hand, friction: Friction, rng: np.random.Generator, camera: JointCamera, protocol: Protocol, base: Hand
) -> Sweep:
    rest = round(protocol.rest * camera.rate_hz)
    held = max(round(protocol.hold * camera.rate_hz) - 1, 1)
    angles = np.linspace(base.servo_min[swept], base.servo_max[swept], protocol.points)
    start = np.arange(rest) / camera.rate_hz
    moving = protocol.rest + protocol.seconds_per_point * np.arange(1, protocol.points + 1)
    holds = (moving[:, None] - np.arange(held)[::-1] / camera.rate_hz).ravel()
    time = np.concatenate([start, holds, holds[-1] + (1 + np.arange(rest)) / camera.rate_hz])
    phase = np.repeat([PHASES.index("rest"), PHASES.index("flexion"), PHASES.index("rest")], [rest, len(holds), rest])
    point = np.concatenate([np.full(rest, -1), np.repeat(np.arange(protocol.points), held), np.full(rest, -1)])
    servo = np.tile(rest_pose(SERVOS[swept]), (len(time), 1))
    servo[phase == PHASES.index("flexion"), swept] = np.repeat(angles, held)
    joint_pos = camera.seen(settled_joints(servo, hand, friction), time, rng)
    return Sweep(np.zeros(len(time), dtype=int), np.full(len(time), swept), phase, point, time, servo, joint_pos)
