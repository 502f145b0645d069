"""The body of the hand: links, joints and masses as data, and its forward kinematics.

Independent of any simulator. The numbers and their sources are in ``data/geometry.toml``.
"""

import tomllib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hpac_gym.model import DIGITS, digit_joints
from hpac_gym.model.checks import Array

Vector = tuple[float, float, float]

DATA = Path(__file__).parent / "data"
FLEXION_AXIS: Vector = (0.0, 1.0, 0.0)


@dataclass(frozen=True, slots=True)
class Box:
    """A box whose faces are parallel to its link's axes."""

    center: Vector
    size: Vector


@dataclass(frozen=True, slots=True)
class Capsule:
    """All points within ``radius`` of the segment from ``start`` to ``end``."""

    start: Vector
    end: Vector
    radius: float


@dataclass(frozen=True, slots=True)
class Phalanx:
    """One moving link: its joint, and a capsule along +z from that joint.

    ``origin`` and ``rpy`` place the link in its parent's frame at joint angle zero; ``axis`` is in
    the link's own frame."""

    joint: str
    parent: str
    origin: Vector
    rpy: Vector
    axis: Vector
    length: float
    mass: float
    capsule: Capsule

    @property
    def link(self) -> str:
        return f"{self.joint}_link"

    @property
    def pin(self) -> Capsule:
        """Pin of its joint, which is drawn but touches nothing."""
        reach = 0.75 * self.capsule.radius
        return Capsule((0.0, -reach, 0.0), (0.0, reach, 0.0), 0.5 * self.capsule.radius)


@dataclass(frozen=True, slots=True)
class Digit:
    """Three phalanges from the palm outwards; ``pad`` is the fingertip's contact point, in the last
    link's frame.
    """

    name: str
    phalanges: tuple[Phalanx, Phalanx, Phalanx]
    pad: Vector
    pad_normal: Vector

    def scaled(self, lengths: Array, thickness: float) -> "Digit":
        """A copy with the link lengths multiplied by ``lengths``, shape (3,), and the radii by
        ``thickness``.
        """
        phalanges = []
        for phalanx, factor in zip(self.phalanges, lengths.tolist(), strict=True):
            length = factor * phalanx.length
            radius = thickness * phalanx.capsule.radius
            end = length - radius if phalanx is self.phalanges[-1] else length
            origin = (0.0, 0.0, phalanges[-1].length) if phalanges else phalanx.origin
            capsule = Capsule((0.0, 0.0, 0.0), (0.0, 0.0, end), radius)
            mass = factor * thickness**2 * phalanx.mass
            phalanges.append(
                replace(phalanx, origin=origin, length=length, mass=mass, capsule=capsule)
            )
        pad = tuple(np.add(capsule.end, np.multiply(radius, self.pad_normal)).tolist())
        return replace(self, phalanges=tuple(phalanges), pad=pad)


@dataclass(frozen=True, slots=True)
class Geometry:
    """Geometry of one hand: palm, digits, and the joints' effort limit [N·m] and velocity limit
    [rad/s].
    """

    palm_mass: float
    palm_solids: tuple[Box | Capsule, ...]
    digits: tuple[Digit, ...]
    effort: float
    velocity: float
    opposition: dict[str, tuple[float, ...]]
    """Synergies that bring the thumb pad onto a finger's pad, by finger, 6 values each [rad]."""

    def __hash__(self) -> int:
        # Hashing all fields would take fifty times as long.
        return hash(tuple(digit.pad for digit in self.digits))

    @property
    def phalanges(self) -> tuple[Phalanx, ...]:
        return tuple(phalanx for digit in self.digits for phalanx in digit.phalanges)

    def digit(self, name: str) -> Digit:
        return next(digit for digit in self.digits if digit.name == name)


def table_of(name: str) -> dict[str, Any]:
    """Contents of a file of ``data``."""
    return tomllib.loads((DATA / name).read_text(encoding="utf-8"))


@cache
def load_geometry() -> Geometry:
    """Geometry of the nominal hand, read from ``data/geometry.toml``."""
    table = table_of("geometry.toml")
    palm = table["palm"]
    boxes = tuple(Box(tuple(box["center"]), tuple(box["size"])) for box in palm["boxes"])
    capsules = tuple(
        Capsule(tuple(c["start"]), tuple(c["end"]), c["radius"]) for c in palm["capsules"]
    )
    pad_tilt = np.deg2rad(table["pad"]["tilt_deg"])
    return Geometry(
        palm_mass=palm["mass"],
        palm_solids=boxes + capsules,
        digits=tuple(_digit(name, table[name], pad_tilt) for name in DIGITS),
        effort=table["limits"]["effort"],
        velocity=table["limits"]["velocity"],
        opposition={finger: tuple(synergy) for finger, synergy in table["opposition"].items()},
    )


def _digit(name: str, table: dict, pad_tilt: float) -> Digit:
    joints = digit_joints(name)
    axis = FLEXION_AXIS
    if name == "thumb":
        joints = ("thumb_cmc", *joints)
        rpy = tuple(table["rpy"])
        axis = rotation_from_rpy(rpy).T @ table["axis"]
        axis = tuple(axis / np.linalg.norm(axis))
    else:
        rpy = (-np.deg2rad(table["fan_deg"]), 0.0, 0.0)
    parent = "palm"
    origin = tuple(table["base"])
    phalanges = []
    for joint, length, radius, mass in zip(
        joints, table["lengths"], table["radii"], table["masses"], strict=True
    ):
        capsule = Capsule((0.0, 0.0, 0.0), (0.0, 0.0, length), radius)
        phalanges.append(Phalanx(joint, parent, origin, rpy, axis, length, mass, capsule))
        parent = phalanges[-1].link
        origin = (0.0, 0.0, length)
        rpy = (0.0, 0.0, 0.0)
        axis = FLEXION_AXIS
    normal = (float(np.cos(pad_tilt)), 0.0, float(np.sin(pad_tilt)))
    digit = Digit(name, tuple(phalanges), capsule.end, normal)
    return digit.scaled(np.ones(3), 1.0)  # which shortens the last capsule and places the pad


def rotation_from_rpy(rpy: Vector) -> Array:
    """The rotation matrix of URDF's fixed-axis roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    roll, pitch, yaw = rpy
    return (
        rotation_about((0, 0, 1), yaw)
        @ rotation_about((0, 1, 0), pitch)
        @ rotation_about((1, 0, 0), roll)
    )


def rotation_about(axis: Vector | Array, angle: float) -> Array:
    """Rotation matrix, shape (3, 3), for a rotation by ``angle`` [rad] about a unit ``axis``
    (Rodrigues).
    """
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def link_poses(digit: Digit, angles: Array) -> list[tuple[Array, Array]]:
    """Position (3,) [m] and rotation (3, 3) of a digit's links in the hand frame.

    Args:
        digit: the digit.
        angles: its joint angles from the palm outwards, shape (3,) [rad].
    """
    position = np.zeros(3)
    rotation = np.eye(3)
    poses = []
    for phalanx, angle in zip(digit.phalanges, angles, strict=True):
        position = position + rotation @ phalanx.origin
        rotation = rotation @ rotation_from_rpy(phalanx.rpy) @ rotation_about(phalanx.axis, angle)
        poses.append((position, rotation))
    return poses


HPAC_GEOMETRY = load_geometry()
"""Geometry of the nominal hand."""
