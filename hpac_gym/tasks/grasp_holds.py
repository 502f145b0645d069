"""Contacts between hand and object while it is held: a `Look` is one moment, a `Hold` some of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY, link_poses
from hpac_gym.model import JOINT_INDEX
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PARTS, Contacts, SceneState

TOUCHES = 0.5
"""A part counts as touching the object if it does so in at least this fraction of the hold."""
AXES = "xyz"
_TIPS = tuple(digit.phalanges[-1].link for digit in HPAC_GEOMETRY.digits)
_BALL = HPAC_GEOMETRY.digit("thumb").phalanges[0].link
"""The metacarpal, the ball of the thumb, which counts as palm: the thumb touches by its last two
links.
"""
_BEYOND_ROOT = tuple(
    phalanx.link for digit in HPAC_GEOMETRY.digits for phalanx in digit.phalanges[1:]
)


@dataclass(frozen=True, slots=True)
class Hole:
    """An opening of an object through which a digit can pass."""

    centre: tuple[float, float, float]
    """Centre of the opening in the object's frame [m]."""
    axis: str
    """Axis of the object's frame that is normal to the opening."""
    half: tuple[float, float]
    """Semi-axes of the elliptic opening along the two other axes, in their order [m]."""

    def scaled(self, scale: float) -> Hole:
        """The opening of an object scaled by a factor."""
        centre, half = (tuple(scale * np.array(values)) for values in (self.centre, self.half))
        return Hole(centre, self.axis, half)

    def hit(self, start: Array, end: Array) -> bool:
        """Whether a segment in the object's frame passes through the opening."""
        normal = AXES.index(self.axis)
        across = [index for index in range(3) if index != normal]
        before = start[normal] - self.centre[normal]
        after = end[normal] - self.centre[normal]
        if before * after > 0:
            return False
        share = before / (before - after) if before != after else 0.0
        point = (start + share * (end - start) - self.centre)[across]
        return bool(np.linalg.norm(point / self.half) <= 1)


@dataclass(frozen=True, slots=True)
class Look:
    """Contacts between hand and object at one moment, with the pose of the object and the joint
    angles.
    """

    links: tuple[str, ...]
    """Link of the hand in each contact."""
    force: Array
    """Normal forces, shape (m,) [N]."""
    point: Array
    """Contact points in the object's frame, shape (m, 3) [m]."""
    normal: Array
    """Contact normals, unit vectors into the object, in its frame, shape (m, 3)."""
    rotation: Array
    """Rotation of the object in the hand, shape (3, 3)."""
    centre: Array
    """Centre of the object in the hand, shape (3,) [m]."""
    joint_pos: Array
    """Joint angles, shape (15,) [rad]."""

    def pressed(self, button: float) -> float:
        """Force of middle and distal links along −z on points above `button` [N]."""
        down = self.force * np.maximum(-self.normal[:, 2], 0.0)
        beyond_root = np.array([link in _BEYOND_ROOT for link in self.links], bool)
        return down[(self.point[:, 2] > button) & beyond_root].sum()

    def poses(self, digit: str) -> dict[str, tuple[Array, Array]]:
        """Position and rotation of a digit's links in the hand frame, by name."""
        body = HPAC_GEOMETRY.digit(digit)
        joints = self.joint_pos[[JOINT_INDEX[phalanx.joint] for phalanx in body.phalanges]]
        links = [phalanx.link for phalanx in body.phalanges]
        return dict(zip(links, link_poses(body, joints), strict=True))

    def through(self, hole: Hole, digit: str) -> float:
        """1 if one of the last two links is in the opening and the digit touches, 0.4 without
        touch, up to 0.3 for a miss.
        """
        poses = list(self.poses(digit).values())
        tip = poses[-1][0] + poses[-1][1] @ (
            0.0,
            0.0,
            HPAC_GEOMETRY.digit(digit).phalanges[-1].length,
        )
        places = (np.array([place for place, _ in poses] + [tip]) - self.centre) @ self.rotation
        if any(hole.hit(start, end) for start, end in itertools.pairwise(places[1:])):
            return 1.0 if digit in map(part_of, self.links) else 0.4
        return 0.3 * float(np.exp(-np.linalg.norm(places[-1] - hole.centre) / 0.03))


def look_at(contacts: Contacts, state: SceneState, world: int, hand_rotation: Array) -> Look:
    """A look at one world's state, given the rotation of its hand in the world, shape (3, 3)."""
    rotation = state.object_rotation[world].copy()
    to_object = (hand_rotation @ rotation).T
    return Look(
        contacts.link,
        contacts.force,
        (contacts.point - contacts.centre) @ to_object.T,
        contacts.normal @ to_object.T,
        rotation,
        state.object_pos[world].copy(),
        state.joint_pos[world].copy(),
    )


@dataclass(frozen=True, slots=True)
class Hold:
    """Contacts observed while an object was held."""

    looks: tuple[Look, ...]
    """Looks at the contacts, at least one."""
    start: Array = field(default_factory=lambda: np.eye(3))
    """Rotation of the object in the hand when the hand began to close, shape (3, 3)."""

    @property
    def touched(self) -> dict[str, float]:
        """Fraction of the looks in which each part touches."""
        each = [set(map(part_of, now.links)) for now in self.looks]
        return {part: float(np.mean([part in parts for parts in each])) for part in PARTS}

    @property
    def force(self) -> float:
        """Mean total contact force [N]."""
        return float(np.mean([now.force.sum() for now in self.looks]))

    @property
    def off_tips(self) -> float:
        """Fraction of the contact force that is not on distal links."""
        return self._share(
            lambda now: np.array([link not in _TIPS for link in now.links], dtype=float)
        )

    @property
    def turn_deg(self) -> float:
        """Largest rotation of the object in the hand since the first look [deg]."""
        first = self.looks[0].rotation
        return max(_angle_deg((np.trace(first.T @ now.rotation) - 1) / 2) for now in self.looks)

    @property
    def tilt_deg(self) -> float:
        """Largest tilt of the object's z axis in the hand relative to `start` [deg]."""
        return max(_angle_deg(self.start[:, 2] @ now.rotation[:, 2]) for now in self.looks)

    def along(self, axis: str) -> float:
        """Fraction of the contact force along an axis of the object, weighted by the normals'
        squared component.
        """
        return self._share(lambda now: now.normal[:, AXES.index(axis)] ** 2)

    def on_side(self, finger: str) -> float:
        """Fraction of a finger's contact force on its side, where the normal is within 45° of the
        hinge axis.
        """
        force = side = 0.0
        for now in self.looks:
            poses = now.poses(finger)
            for link, push, normal in zip(now.links, now.force, now.normal, strict=True):
                if link in poses:
                    hinge = poses[link][1][:, 1]
                    lateral = abs((now.rotation @ normal) @ hinge) > np.sqrt(0.5)
                    force = force + push
                    side = side + push * lateral
        return side / force if force > 0 else 0.0

    def pressed(self, button: float) -> float:
        """Mean force of middle and distal links along −z on points above `button` [N]."""
        return float(np.mean([now.pressed(button) for now in self.looks]))

    def through(self, holes: Sequence[Hole], digit: str) -> float:
        """Fraction of the looks with a digit through an opening and touching; below `TOUCHES`, near
        misses count in part.
        """
        seen = np.array([max(now.through(hole, digit) for hole in holes) for now in self.looks])
        share = float(np.mean(seen == 1.0))
        return share if share >= TOUCHES else min(float(np.mean(seen)), 0.99 * TOUCHES)

    def most(self, parts: Sequence[str], count: int) -> float:
        """Score, 0 to 1, for at least `count` of some parts touching."""
        touched = self.touched
        best = sorted((min(touched[part] / TOUCHES, 1.0) for part in parts), reverse=True)
        return sum(best[:count]) / count

    def _share(self, weight: Callable[[Look], Array]) -> float:
        """Fraction of the contact force, weighted; 0 without any."""
        total = sum(now.force.sum() for now in self.looks)
        if not total > 0:
            return 0.0
        shares = ((now.force * weight(now)).sum() for now in self.looks if len(now.links))
        return float(sum(shares) / total)


def part_of(link: str) -> str:
    """The part of the hand that a link belongs to."""
    return "palm" if link == _BALL else link.split("_")[0]


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
