"""The sixteen grasp types as data: the placement of the object for the posture of the same name, and
the rule by which the grasp is judged: which parts of the hand touch the object, where, and with what
force.

The numbers are in ``data/grasp_types.toml``. A `Rule` is evaluated on a `Hold`, some looks at the
contacts while the object is held."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpac_gym.model import (
    DIGITS,
    FINGERS,
    POSTURES,
    clip_synergy,
    clip_to_workspace,
    synergy_from_joints,
)
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PARTS, Contacts, SceneSetup, SceneState, matrix_from_quaternion
from hpac_gym.settings import setting
from hpac_gym.tasks.grasp_data import DATA, GraspError, NamedGrasp, grasps_of, with_tuples
from hpac_gym.tasks.grasp_holds import AXES, TOUCHES, Hold, Hole, look_at
from hpac_gym.tasks.task import FINGER_PARTS, THUMB_PART
from hpac_gym.tasks.terms import Term

HELD_OUT_TYPES = ("large_sphere", "three_finger_pinch", "screwdriver", "tape_roll")
"""Held-out types, never used in training. Chosen: each is similar to one of the others."""
SPARES = 0.1
"""Largest fraction of the hold, or of the force, at which a part counts as not touching the object.
"""
ASKED = (
    *("fingers", "digits", "tips", "force", "press", "along_x", "along_y", "along_z"),
    *("side", "through", "turn", "tilt"),
)
"""Entries of `Rule.asked`."""


@dataclass(frozen=True, slots=True)
class Rule:
    """Conditions that define a grasp type. Parts are `hpac_gym.physics.engine.PARTS`."""

    touch: tuple[str, ...] = ()
    """Parts that must all touch the object."""
    fingers: int = setting(0, "least number of fingers that touch the object")
    digits: int = setting(0, "least number of digits that touch the object")
    never: tuple[str, ...] = ()
    """Parts that must not touch the object."""
    tips: bool = False
    """True if only the digits' distal links may touch the object."""
    force: float = setting(0.0, "least total contact force, averaged over the hold [N]")
    turn_deg: float = setting(
        20.0, "largest rotation of the object in the hand while it is held [deg]"
    )
    tilt_deg: float = setting(
        180.0, "largest tilt of the object's z axis since the hand began to close [deg]"
    )
    axis: str = "z"
    """Axis of the object for `along` and `across`."""
    along: float = setting(0.0, "least fraction of the contact force along that axis")
    across: float = setting(0.0, "least fraction of the contact force across that axis")
    side: str = ""
    """Finger whose contact must be on its side, not on its pad; empty for none."""
    button: float = np.inf
    """Height in the object's frame above which the button lies [m]."""
    press: float = setting(0.0, "least force that presses the button down along −z [N]")
    holes: tuple[Hole, ...] = ()
    """Openings of the object."""
    through: tuple[str, ...] = ()
    """Digits that must each pass through an opening and touch the object."""

    def scaled(self, scale: float) -> Rule:
        """The rule for an object scaled by a factor."""
        holes = tuple(hole.scaled(scale) for hole in self.holes)
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
        return [
            self.fingers,
            self.digits,
            float(self.tips),
            self.force / 10,
            self.press / 10,
            *((self.along - self.across) * (axis == self.axis) for axis in AXES),
            float(bool(self.side)),
            float(bool(self.through)),
            *np.deg2rad([self.turn_deg, self.tilt_deg]).tolist(),
        ]

    def _asked_of(self, name: str) -> Sequence[Any]:
        """What a field asks for: each of its parts, its number, or nothing with the default."""
        given = getattr(self, name)
        if isinstance(given, tuple):
            return given
        default = type(self).__dataclass_fields__[name].default
        return [given] if given != default or name == "turn_deg" else []

    def terms(self) -> list[tuple[str, Callable[..., float], Any]]:
        """The rule's clauses: words, the score of a hold for this rule, and what it asks for."""
        return [
            (words.format(asked, rule=self), score, asked)
            for name, words, score in _CLAUSES
            for asked in self._asked_of(name)
        ]

    def clauses(self, hold: Hold) -> dict[str, float]:
        """Score of a hold for each clause of the rule: 1 satisfies it, less does so in part."""
        return {words: min(score(hold, self, asked), 1.0) for words, score, asked in self.terms()}


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


class Judged:
    """Holds of n worlds, each judged by the rule of its episode.

    Args:
        num_worlds: n.

    Attributes:
        kept: score of the rule, 0 to 1: the mean over its clauses at the last evaluation; while the
            hand closes, the fraction of the required parts that touch, shape (n,).
        missed: the clauses that the last evaluation missed, in words, shape (n,).
    """

    changing = ("kept", "missed", "_asked", "_counts", "_rules", "_seen", "_start", "_hand")

    def __init__(self, num_worlds: int) -> None:
        self.kept = np.zeros(num_worlds)
        self.missed, self._rules, self._seen = (
            np.full(num_worlds, "", dtype=object) for _ in range(3)
        )
        self._asked = np.zeros((num_worlds, len(PARTS)))
        self._counts = np.zeros((num_worlds, 2), dtype=int)
        self._start, self._hand = np.zeros((2, num_worlds, 3, 3))

    def start(self, world: int, rule: Rule, setup: SceneSetup) -> None:
        """Begin an episode of a world."""
        self._asked[world] = rule.asked_parts
        self._counts[world] = (rule.fingers, rule.digits)
        self._rules[world] = rule
        self._seen[world] = ()
        self._hand[world] = setup.hand_rotation
        self._start[world] = setup.hand_rotation.T @ matrix_from_quaternion(setup.object_turn[0])
        self.missed[world] = "nothing touches"  # until it is evaluated
        self.kept[world] = 0.0

    def touched_share(self, touching: NDArray[np.bool_]) -> Array:
        """Fraction of the required parts that touch, shape (n,)."""
        fingers = touching[:, FINGER_PARTS].sum(axis=1)
        counts = np.stack([fingers, fingers + touching[:, THUMB_PART]], axis=1)
        touch = self._asked > 0
        found = (touching & touch).sum(axis=1) + np.minimum(counts, self._counts).sum(axis=1)
        return found / np.maximum(touch.sum(axis=1) + self._counts.sum(axis=1), 1)

    def forbidden(self, touching: NDArray[np.bool_]) -> NDArray[np.int_]:
        """Number of parts that touch and must not, shape (n,)."""
        return (touching & (self._asked < 0)).sum(axis=1)

    def follow(
        self,
        state: SceneState,
        since: Array,
        wanted: NDArray[np.bool_],
        contacts: Callable[[int], Contacts],
    ) -> None:
        """Advance by one control step.

        Args:
            state: state of the worlds.
            since: control steps since the hold began, shape (n,); negative while the hand closes.
            wanted: worlds whose contacts are looked at in this step, shape (n,).
            contacts: function of a world that returns its contacts.
        """
        self.kept = np.where(since < 0, self.touched_share(state.touching), self.kept)
        for world in np.flatnonzero(wanted):
            if since[world] == 0:
                self._seen[world] = ()
            self.look(world, state, contacts(world))

    def look(self, world: int, state: SceneState, contacts: Contacts) -> None:
        """Add the current contacts of a world to its hold, and evaluate its rule."""
        self._seen[world] += (look_at(contacts, state, world, self._hand[world]),)
        clauses = self._rules[world].clauses(self.hold(world))
        self.kept[world] = np.mean(list(clauses.values()))
        self.missed[world] = "; ".join(name for name, value in clauses.items() if value < 1)

    def hold(self, world: int) -> Hold:
        """The hold of a world as observed so far."""
        return Hold(self._seen[world], self._start[world].copy())


@dataclass(frozen=True, slots=True)
class GraspType:
    """One of the sixteen types: the placement of its object for the posture, and the rule that
    defines it.
    """

    start: NamedGrasp
    """Object, wrist and support; `closed` is the synergy of the posture of the same name."""
    rule: Rule


def data_text() -> str:
    """Text of ``data/grasp_types.toml``."""
    return (DATA / "grasp_types.toml").read_text(encoding="utf-8")


def _grasp_types() -> dict[str, GraspType]:
    """The types of the file: each is a grasp as in ``grasps.toml`` without `closed`, and its
    `rule`.
    """
    tables = tomllib.loads(data_text())
    rules = {}
    for name in tables.keys() - {"held_out"}:
        rule = with_tuples(tables[name].pop("rule"))
        holes = tuple(Hole(**with_tuples(hole)) for hole in rule.pop("holes", ()))
        rules[name] = Rule(holes=holes, **rule)
        # The synergy that reaches the posture's q_d by Eqs. (14) and (15).
        reachable = clip_to_workspace(POSTURES[name].target_joint_pos)
        tables[name]["closed"] = clip_synergy(synergy_from_joints(reachable))
    return {name: GraspType(start, rules[name]) for name, start in grasps_of(tables).items()}


GRASP_TYPES: Mapping[str, GraspType] = MappingProxyType(_grasp_types())
"""All grasp types by name, in the order of the paper's panels."""
TYPE_SPLITS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "all": tuple(GRASP_TYPES),
        "train": tuple(name for name in GRASP_TYPES if name not in HELD_OUT_TYPES),
        "test": HELD_OUT_TYPES,
    }
)
TYPE_TERMS = (
    Term(
        "type",
        tuple(GRASP_TYPES),
        "0/1",
        0.0,
        1.0,
        "requested grasp type, one-hot",
        lambda setup: [float(setup.grasp == name) for name in GRASP_TYPES],
        fixed=True,
    ),
    Term(
        "asked_parts",
        PARTS,
        "1",
        -1.0,
        1.0,
        "1 for a part that must touch the object, −1 for one that must not",
        lambda setup: GRASP_TYPES[setup.grasp].rule.asked_parts,
        fixed=True,
    ),
    Term(
        "asked",
        ASKED,
        "1, 10 N, rad",
        -1.0,
        4.0,
        "other conditions: least numbers of fingers and digits that touch, only "
        "last links, least force, least force on the button, shares of the force along the object's axes (negative: across), "
        "side of the index, thumb through an opening, largest turn in the hand and of the object's axis",
        lambda setup: GRASP_TYPES[setup.grasp].rule.asked,
        fixed=True,
    ),
)
"""Encoding of the type for a policy: its name, and the conditions of its rule, which also describe
unseen types.
"""


def chosen_types(types: str | Sequence[str]) -> tuple[GraspType, ...]:
    """The types of a split of `TYPE_SPLITS`, of one name, or of several names.

    Raises:
        GraspError: Unknown type.
    """
    if isinstance(types, str):
        types = TYPE_SPLITS.get(types, (types,))
    names = types if types and isinstance(types, list | tuple) else (types,)
    for name in names:
        if not isinstance(name, str) or name not in GRASP_TYPES:
            raise GraspError(
                f"no grasp type {name!r}; there are {', '.join((*TYPE_SPLITS, *GRASP_TYPES))}"
            )
    return tuple(GRASP_TYPES[name] for name in names)
