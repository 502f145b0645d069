"""Rules that define the grasp types: which parts of the hand touch the object, where, and with what
force.

A `Rule` is evaluated on a `Hold`, some looks at the contacts while the object is held.
``data/grasp_types.toml`` has the rule of every type."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from hpac_gym.body.geometry import link_poses, load_geometry
from hpac_gym.errors import ParameterError
from hpac_gym.model import DIGITS, FINGERS, JOINT_INDEX
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PARTS, Contacts, SceneState

TOUCHES = 0.5
"""A part counts as touching the object if it does so in at least this fraction of the hold."""
SPARES = 0.1
"""Largest fraction of the hold, or of the force, at which a part counts as not touching the object.
"""
ASKED = (
    "fingers",
    "digits",
    "tips",
    "force",
    "press",
    "along_x",
    "along_y",
    "along_z",
    "side",
    "through",
    "turn",
    "tilt",
)
"""Entries of `Rule.asked`."""
_AXES = "xyz"
_GEOMETRY = load_geometry()
_TIPS = tuple(digit.phalanges[-1].link for digit in _GEOMETRY.digits)
_BALL = _GEOMETRY.digit("thumb").phalanges[0].link
"""The metacarpal, the ball of the thumb, which counts as palm: the thumb touches by its last two
links.
"""
_BEYOND_ROOT = tuple(phalanx.link for digit in _GEOMETRY.digits for phalanx in digit.phalanges[1:])


@dataclass(frozen=True, slots=True)
class Hole:
    """An opening of an object through which a digit can pass."""

    centre: tuple[float, float, float]
    """Centre of the opening in the object's frame [m]."""
    axis: str
    """Axis of the object's frame that is normal to the opening."""
    half: tuple[float, float]
    """Semi-axes of the elliptic opening along the two other axes, in their order [m]."""

    def outside(self, start: Array, end: Array) -> float:
        """Distance by which a segment in the object's frame misses the opening: 0 on a hit,
        infinite beside its plane [m].
        """
        normal = _AXES.index(self.axis)
        across = [index for index in range(3) if index != normal]
        before = start[normal] - self.centre[normal]
        after = end[normal] - self.centre[normal]
        if before * after > 0:
            return np.inf
        share = before / (before - after) if before != after else 0.0
        point = (start + share * (end - start) - self.centre)[across]
        distance = float(np.linalg.norm(point / self.half))
        return 0.0 if distance <= 1 else float(np.linalg.norm(point) * (1 - 1 / distance))


@dataclass(frozen=True, slots=True)
class Rule:
    """Conditions that define a grasp type. Parts are `hpac_gym.physics.engine.PARTS`."""

    touch: tuple[str, ...] = ()
    """Parts that must all touch the object."""
    fingers: int = 0
    """Least number of fingers, without the thumb, that touch the object."""
    digits: int = 0
    """Least number of digits, with the thumb, that touch the object."""
    never: tuple[str, ...] = ()
    """Parts that must not touch the object."""
    tips: bool = False
    """True if only the digits' distal links may touch the object."""
    force: float = 0.0
    """Least total contact force, averaged over the hold [N]."""
    turn_deg: float = 20.0
    """Largest rotation of the object in the hand while it is held [deg]."""
    tilt_deg: float = 180.0
    """Largest tilt of the object's z axis in the hand since the hand began to close [deg]."""
    axis: str = "z"
    """Axis of the object for `along` and `across`."""
    along: float = 0.0
    """Least fraction of the contact force along that axis."""
    across: float = 0.0
    """Least fraction of the contact force across that axis."""
    side: str = ""
    """Finger whose contact must be on its side, not on its pad; empty for none."""
    button: float = np.inf
    """Height in the object's frame above which the button lies [m]."""
    press: float = 0.0
    """Least force that presses the button down along −z [N]."""
    holes: tuple[Hole, ...] = ()
    """Openings of the object."""
    through: tuple[str, ...] = ()
    """Digits that must each pass through an opening and touch the object."""

    def __post_init__(self) -> None:
        for name, allowed in (("touch", PARTS), ("never", PARTS), ("through", DIGITS)):
            if unknown := set(getattr(self, name)) - set(allowed):
                raise ParameterError(
                    f"{name} has {', '.join(sorted(unknown))}, which is not one of {', '.join(allowed)}"
                )
        if self.axis not in _AXES or self.side not in ("", *FINGERS):
            raise ParameterError(
                f"axis {self.axis!r} must be x, y or z, and side {self.side!r} a finger"
            )
        if not (0 <= self.fingers <= len(FINGERS) and 0 <= self.digits <= len(DIGITS)):
            bounds = f"0 to {len(FINGERS)} and 0 to {len(DIGITS)}"
            raise ParameterError(
                f"fingers {self.fingers} and digits {self.digits} must be {bounds}"
            )
        if not (0 <= self.along <= 1 and 0 <= self.across <= 1):
            raise ParameterError(f"along {self.along} and across {self.across} must be 0 to 1")
        if not (self.force >= 0 and self.press >= 0 and self.turn_deg > 0 and self.tilt_deg > 0):
            angles = f"turn {self.turn_deg} and tilt {self.tilt_deg} deg greater than 0"
            raise ParameterError(
                f"force {self.force} and press {self.press} N must be at least 0, {angles}"
            )

    def scaled(self, scale: float) -> Rule:
        """The rule for an object scaled by a factor."""
        holes = tuple(
            Hole(
                tuple(scale * np.array(hole.centre)), hole.axis, tuple(scale * np.array(hole.half))
            )
            for hole in self.holes
        )
        return replace(self, button=scale * self.button, holes=holes)

    @property
    def asked_parts(self) -> list[float]:
        """For each of `PARTS`: 1 if it must touch, −1 if it must not, 0 if it may."""
        touch = {*self.touch, *self.through}
        return [float(part in touch) - float(part in self.never) for part in PARTS]

    @property
    def asked(self) -> list[float]:
        """The other conditions as numbers, in the order of `ASKED`: counts, forces in 10 N, angles
        in rad.
        """
        along = [(self.along - self.across) * (axis == self.axis) for axis in _AXES]
        flags = map(float, (bool(self.side), bool(self.through)))
        angles = np.deg2rad([self.turn_deg, self.tilt_deg]).tolist()
        return [
            self.fingers,
            self.digits,
            float(self.tips),
            self.force / 10,
            self.press / 10,
            *along,
            *flags,
            *angles,
        ]

    def terms(self) -> list[tuple[str, Callable[[Hold], float]]]:
        """The rule's clauses in words, each with its score of a hold: 1 or more satisfies it, less
        does so in part.
        """
        return [
            (words.format(asked, rule=self), partial(score, rule=self, asked=asked))
            for name, words, score in _CLAUSES
            for asked in self._asked_of(name)
        ]

    def _asked_of(self, name: str) -> Sequence[Any]:
        """What a field asks for: each of its parts, its number, or nothing with the default."""
        given = getattr(self, name)
        if isinstance(given, tuple):
            return given
        default = type(self).__dataclass_fields__[name].default
        return [given] if given != default or name == "turn_deg" else []

    def clauses(self, hold: Hold) -> dict[str, float]:
        """Score of a hold for each clause of the rule: 1 satisfies it, less does so in part."""
        return {name: min(value(hold), 1.0) for name, value in self.terms()}

    def kept(self, hold: Hold) -> bool:
        """True if a hold satisfies all clauses."""
        return all(value >= 1.0 for value in self.clauses(hold).values())


_CLAUSES: tuple[tuple[str, str, Callable[..., float]], ...] = (
    ("touch", "{0} touches", lambda hold, rule, asked: hold.touched[asked] / TOUCHES),
    ("fingers", "{0} fingers touch", lambda hold, rule, asked: hold.most(FINGERS, asked)),
    ("digits", "{0} digits touch", lambda hold, rule, asked: hold.most(DIGITS, asked)),
    (
        "never",
        "{0} does not touch",
        lambda hold, rule, asked: _at_most(hold.touched[asked], SPARES),
    ),
    ("tips", "only last links touch", lambda hold, rule, asked: _at_most(hold.off_tips, SPARES)),
    ("force", "held with {0:g} N", lambda hold, rule, asked: hold.force / asked),
    (
        "turn_deg",
        "turns by at most {0:g}°",
        lambda hold, rule, asked: asked / max(hold.turn_deg, 1e-9),
    ),
    ("tilt_deg", "axis within {0:g}°", lambda hold, rule, asked: asked / max(hold.tilt_deg, 1e-9)),
    ("along", "held along {rule.axis}", lambda hold, rule, asked: hold.along(rule.axis) / asked),
    (
        "across",
        "held across {rule.axis}",
        lambda hold, rule, asked: _at_most(hold.along(rule.axis), 1 - asked),
    ),
    ("side", "side of the {0}", lambda hold, rule, asked: hold.on_side(asked) / TOUCHES),
    (
        "press",
        "button pressed with {0:g} N",
        lambda hold, rule, asked: hold.pressed(rule.button) / asked,
    ),
    (
        "through",
        "{0} through an opening",
        lambda hold, rule, asked: hold.through(rule.holes, asked) / TOUCHES,
    ),
)
"""The clauses: the field that asks for one, its words, and its score of a hold."""


def _at_most(value: float, limit: float) -> float:
    return 1.0 if value <= limit else (1.0 - value) / (1.0 - limit) * 0.99


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
        return {
            part: float(
                np.mean([any(_part(link) == part for link in now.links) for now in self.looks])
            )
            for part in PARTS
        }

    @property
    def part_force(self) -> dict[str, float]:
        """Mean normal force of each part [N]."""
        return {
            part: float(
                np.mean(
                    [
                        sum(
                            f
                            for f, link in zip(now.force, now.links, strict=True)
                            if _part(link) == part
                        )
                        for now in self.looks
                    ]
                )
            )
            for part in PARTS
        }

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
        return self._share(lambda now: now.normal[:, _AXES.index(axis)] ** 2)

    def on_side(self, finger: str) -> float:
        """Fraction of a finger's contact force on its side, where the normal is within 45° of the
        hinge axis.
        """
        force = side = 0.0
        for now in self.looks:
            frames = dict(now.frames(finger))
            for link, push, normal in zip(now.links, now.force, now.normal, strict=True):
                if link in frames:
                    lateral = abs((now.rotation @ normal) @ frames[link][:, 1]) > np.sqrt(0.5)
                    force = force + push
                    side = side + push * lateral
        return side / force if force > 0 else 0.0

    def pressed(self, button: float) -> float:
        """Mean force of middle and distal links along −z on points above `button` [N]."""
        found = []
        for now in self.looks:
            down = now.force * np.maximum(-now.normal[:, 2], 0.0)
            found.append(
                down[
                    (now.point[:, 2] > button)
                    & np.array([link in _BEYOND_ROOT for link in now.links], bool)
                ].sum()
            )
        return float(np.mean(found))

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

    def _share(self, weight: Any) -> float:
        total = sum(now.force.sum() for now in self.looks)
        return (
            float(
                sum((now.force * weight(now)).sum() for now in self.looks if len(now.links)) / total
            )
            if total > 0
            else 0.0
        )


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

    def poses(self, digit: str) -> list[tuple[Array, Array]]:
        """Position and rotation of a digit's links in the hand frame."""
        body = _GEOMETRY.digit(digit)
        return link_poses(
            body, self.joint_pos[[JOINT_INDEX[phalanx.joint] for phalanx in body.phalanges]]
        )

    def frames(self, digit: str) -> list[tuple[str, Array]]:
        """Name and rotation in the hand frame of a digit's links."""
        links = (phalanx.link for phalanx in _GEOMETRY.digit(digit).phalanges)
        return [(link, turn) for link, (_, turn) in zip(links, self.poses(digit), strict=True)]

    def through(self, hole: Hole, digit: str) -> float:
        """1 if one of the last two links is in the opening and the digit touches, 0.4 without
        touch, up to 0.3 for a miss.
        """
        poses = self.poses(digit)
        tip = poses[-1][0] + poses[-1][1] @ (0.0, 0.0, _GEOMETRY.digit(digit).phalanges[-1].length)
        places = (np.array([place for place, _ in poses] + [tip]) - self.centre) @ self.rotation
        missed = min(hole.outside(start, end) for start, end in itertools.pairwise(places[1:]))
        touches = any(_part(link) == digit for link in self.links)
        if missed == 0:
            return 1.0 if touches else 0.4
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


def _part(link: str) -> str:
    return "palm" if link == _BALL else link.split("_")[0]


def _angle_deg(cosine: float) -> float:
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
