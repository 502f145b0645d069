"""Named postures: the paper's 13 gestures and the hand shapes of its 16 grasps, as fifteen joint
targets each.
"""

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hpac_gym.errors import HpacError
from hpac_gym.model.checks import Array, as_finite_vector, read_only
from hpac_gym.model.command import clip_to_workspace, servo_from_joints
from hpac_gym.model.files import HPAC
from hpac_gym.model.joints import FINGERS, JOINTS
from hpac_gym.model.parameters import Hand
from hpac_gym.model.settled import settled_joints_from_servo, settled_servo_from_joints
from hpac_gym.model.transmission import elastic_joints_from_servo


class PostureError(HpacError, LookupError):
    """No posture has this name."""


@dataclass(frozen=True, slots=True)
class Posture:
    """A named joint-space target."""

    name: str
    panel: int
    """Panel number in the paper's figure of postures and grasps, 1 to 29."""
    kind: str
    """`opposition`, `gesture` or `grasp`."""
    about: str
    target_joint_pos: Array
    """q_d, shape (15,) [rad], read-only."""
    aliases: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Reach:
    """The reachable posture nearest to a target, and its servo angles."""

    joint_pos: Array
    """Posture that the hand reaches, on its elastic manifold, shape (15,) [rad]."""
    servo: Array
    """u★ of Eq. (15), shape (6,) [rad]."""
    distance: float
    """Euclidean distance between the target and the reached posture, over all joints [rad]."""


def _posture(name: str, table: dict[str, Any]) -> Posture:
    *thumb, cmc = table["thumb"]
    fingers = [angle for finger in FINGERS for angle in table[finger]]
    target = read_only(np.array([*thumb, *fingers, cmc], dtype=float))  # in the order of `JOINTS`
    return Posture(
        name, table["panel"], table["kind"], table["about"], target, tuple(table.get("aliases", ()))
    )


_TABLE = tomllib.loads(
    (files("hpac_gym.model") / "data" / "postures.toml").read_text(encoding="utf-8")
)

POSTURES: Mapping[str, Posture] = MappingProxyType(
    {name: _posture(name, entry) for name, entry in _TABLE.items() if name != "schema"}
)
"""All 29 postures by name, in the order of the paper's panels."""

_BY_ANY_NAME = {
    name: posture for posture in POSTURES.values() for name in (posture.name, *posture.aliases)
}


def posture(name: str) -> Posture:
    """Posture with a given name or alias.

    Raises:
        PostureError: Unknown name; the message suggests similar ones.
    """
    if name in _BY_ANY_NAME:
        return _BY_ANY_NAME[name]
    near = difflib.get_close_matches(name, _BY_ANY_NAME, n=3, cutoff=0.4) or list(_BY_ANY_NAME)[:3]
    raise PostureError(
        f"no posture {name!r}; there are {len(POSTURES)}, among them {', '.join(near)}"
    )


def reach(target_joint_pos: ArrayLike, hand: Hand = HPAC) -> Reach:
    """Reachable posture nearest to a target: clipped by Eq. (14), then projected onto the elastic
    manifold by Eq. (15).

    A calibrated hand is commanded by `settled_servo_from_joints` instead, in flexion, as from the
    open hand, within the nominal board's range.

    Args:
        target_joint_pos: q_d, shape (15,) [rad].
        hand: the parameters.

    Raises:
        ShapeError: Wrong shape, NaN or infinity.
    """
    target = as_finite_vector(target_joint_pos, len(JOINTS), "target_joint_pos")
    wanted = clip_to_workspace(target, hand)
    if hand.is_calibrated:
        servo = settled_servo_from_joints(wanted, hand)
        servo = np.clip(servo, HPAC.servo_min, HPAC.servo_max)
        joint_pos = settled_joints_from_servo(servo, hand)
    else:
        servo = servo_from_joints(wanted, hand)
        joint_pos = elastic_joints_from_servo(servo, hand)
    return Reach(joint_pos, servo, float(np.linalg.norm(target - joint_pos)))
