"""The sixteen grasp types as data: the placement of the object for the posture of the same name, and
the rule by which the grasp is judged.

The numbers are in ``data/grasp_types.toml``."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType

from hpac_gym.body.object_models import load_object_models
from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    POSTURES,
    clip_synergy,
    clip_to_workspace,
    synergy_from_joints,
)
from hpac_gym.physics.engine import PARTS
from hpac_gym.tasks.grasp_data import (
    GraspError,
    NamedGrasp,
    grasps_from_toml,
    refusing,
    with_tuples,
)
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


def grasp_types_from_toml(text: str) -> dict[str, GraspType]:
    """Types described by a TOML text: each is a grasp as in ``grasps.toml`` without `closed`, and
    its `rule`.

    Raises:
        ParameterError: Not TOML, a name without a posture, or a field that is missing, unknown or
            out of bounds.
    """
    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ParameterError(f"grasp types: {error}") from None
    rules = {}
    for name, entry in table.items():
        if name == "held_out":
            continue
        if name not in POSTURES:
            raise ParameterError(f"grasp type {name}: there is no posture of this name")
        if "closed" in entry:
            raise ParameterError(
                f"grasp type {name}: unknown fields closed; the posture {name} says how the hand closes"
            )
        with refusing(f"grasp type {name}"):
            rule = with_tuples(entry.pop("rule"))
            holes = tuple(Hole(**with_tuples(hole)) for hole in rule.pop("holes", ()))
            rules[name] = Rule(holes=holes, **rule)
    # The synergies that reach the postures' q_d by Eqs. (14) and (15).
    closed = {
        name: clip_synergy(synergy_from_joints(clip_to_workspace(POSTURES[name].target_joint_pos)))
        for name in rules
    }
    starts = grasps_from_toml(table, load_object_models(), closed)
    return {name: GraspType(start, rules[name]) for name, start in starts.items()}


def data_text() -> str:
    """Text of ``data/grasp_types.toml``."""
    return (files("hpac_gym.tasks") / "data" / "grasp_types.toml").read_text(encoding="utf-8")


GRASP_TYPES: Mapping[str, GraspType] = MappingProxyType(grasp_types_from_toml(data_text()))
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
