"""The sixteen grasp types as data: the placement of the object for the posture of the same name, and
the rule by which the grasp is judged.

The numbers are in ``data/grasp_types.toml``."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from hpac_gym.model import (
    POSTURES,
    clip_synergy,
    clip_to_workspace,
    synergy_from_joints,
)
from hpac_gym.physics.engine import PARTS
from hpac_gym.tasks.grasp_data import DATA, GraspError, NamedGrasp, grasps_of, with_tuples
from hpac_gym.tasks.grasp_holds import Hole
from hpac_gym.tasks.grasp_rules import ASKED, Rule
from hpac_gym.tasks.terms import Term

HELD_OUT_TYPES = ("large_sphere", "three_finger_pinch", "screwdriver", "tape_roll")
"""Held-out types, never used in training. Chosen: each is similar to one of the others."""


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
    names = types if isinstance(types, list | tuple) else (types,)
    if not names or (
        unknown := [name for name in names if not isinstance(name, str) or name not in GRASP_TYPES]
    ):
        wrong = unknown[0] if names else types
        raise GraspError(
            f"no grasp type {wrong!r}; there are {', '.join((*TYPE_SPLITS, *GRASP_TYPES))}"
        )
    return tuple(GRASP_TYPES[name] for name in names)
