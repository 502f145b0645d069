"""The sixteen named grasps as data: object, hand shape, wrist pose, support, noise and held-out
variants; and the draw of their episodes.

The numbers are in ``data/grasps.toml``; the names are those of the grasp shapes in
`hpac_gym.model.POSTURES`."""

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from hpac_gym.body.object_models import ObjectModel, load_object_models
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.errors import HpacError
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array, read_only
from hpac_gym.physics.engine import SceneSetup

DATA = files("hpac_gym.tasks") / "data"
NOMINAL = "nominal"

Vector = tuple[float, float, float]


class GraspError(HpacError, LookupError):
    """No grasp, or no variant of a grasp, has this name."""


@dataclass(frozen=True, slots=True)
class Variant:
    """An object that differs from the nominal one: factors of its size, mass and friction, or
    another object.
    """

    scale: float = 1.0
    mass: float = 1.0
    friction: float = 1.0
    object: ObjectModel | None = None
    """Object that replaces the grasp's own, in its pose and on its support; None keeps the own one.
    """


@dataclass(frozen=True, slots=True)
class NamedGrasp:
    """One named grasp: the data from which its episodes are drawn, and its scripted closure."""

    name: str
    family: str
    about: str
    object: ObjectModel
    friction: float
    """Coulomb coefficient of the object's surface."""
    hand_rpy: Vector
    """Orientation of the hand's frame in the world: fixed-axis roll, pitch, yaw [rad]."""
    object_rpy: Vector
    """Orientation of the object's frame in the world: fixed-axis roll, pitch, yaw [rad]."""
    position: Vector
    """Centre of the object in the hand frame [m]."""
    preshape: Array
    """Initial synergy, shape (6,) [rad]."""
    closed: Array
    """Final synergy of the scripted closure, shape (6,) [rad]."""
    support: Support
    position_noise: Vector
    """Half-ranges of the position noise along the axes of the hand frame [m]."""
    yaw_noise: float
    """Half-range of the yaw noise about the vertical [rad]."""
    held_out: Mapping[str, Variant]
    """Held-out variants by name, which no default episode uses."""

    def variant(self, name: str) -> Variant:
        """The variant of that name; "nominal" is the object itself.

        Raises:
            GraspError: Unknown variant.
        """
        if name == NOMINAL:
            return Variant()
        if not isinstance(name, str) or name not in self.held_out:
            raise GraspError(
                f"grasp {self.name} has no variant {name!r}; it has {NOMINAL}, {', '.join(self.held_out)}"
            )
        return self.held_out[name]


def named_grasp(name: str) -> NamedGrasp:
    """The grasp of that name.

    Raises:
        GraspError: Unknown grasp; the message suggests similar names.
    """
    if isinstance(name, str) and name in GRASPS:
        return GRASPS[name]
    near = difflib.get_close_matches(str(name), GRASPS, n=3, cutoff=0.3) or list(GRASPS)[:3]
    raise GraspError(f"no grasp {name!r}; there are {len(GRASPS)}, among them {', '.join(near)}")


def grasps_of(tables: dict[str, Any]) -> dict[str, NamedGrasp]:
    """Grasps described by the tables of a file of ``data``, which are used up: `held_out` has the
    variants of all of them, each other one is a grasp.
    """
    models = load_object_models()
    common = _variants(tables.pop("held_out"), models)
    found = {}
    for name, table in tables.items():
        own = _variants(table.pop("held_out", {}), models)
        found[name] = NamedGrasp(
            name=name,
            object=models[table.pop("object")],
            hand_rpy=tuple(np.deg2rad(table.pop("hand_rpy_deg")).tolist()),
            object_rpy=tuple(np.deg2rad(table.pop("object_rpy_deg")).tolist()),
            preshape=read_only(np.array(table.pop("preshape"), float)),
            closed=read_only(np.array(table.pop("closed"), float)),
            support=Support(**with_tuples(table.pop("support"))),
            held_out=MappingProxyType(common | own),
            **with_tuples(table),
        )
    return found


def with_tuples(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table whose lists are tuples."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}


def _variants(
    tables: Mapping[str, dict[str, Any]], models: Mapping[str, ObjectModel]
) -> dict[str, Variant]:
    found = {}
    for name, table in tables.items():
        known = {"object": models[table["object"]]} if "object" in table else {}
        found[name] = Variant(**table | known)
    return found


def setup_of_grasp(
    grasp: NamedGrasp,
    variant: Variant,
    rng: np.random.Generator,
    hand: Hand = HPAC,
    spread: float = 1.0,
) -> SceneSetup:
    """Draw one episode of a named grasp, with `spread` times its position and yaw noise."""
    model = variant.object or grasp.object
    spec = ObjectSpec(
        model.shape,
        tuple(variant.scale * half for half in model.half_extents),
        variant.mass * model.mass,
        variant.friction * grasp.friction,
        model.name,
        variant.scale,
    )
    noise = spread * rng.uniform(-1.0, 1.0, 4)
    gap = grasp.support.gap and tuple((np.array(grasp.support.gap) * variant.scale).tolist())
    return SceneSetup(
        spec,
        np.array(grasp.position) + noise[:3] * grasp.position_noise,
        float(noise[3] * grasp.yaw_noise),
        grasp.preshape,
        hand,
        hand_quaternion=quaternion_from_rpy(grasp.hand_rpy),
        object_quaternion=quaternion_from_rpy(grasp.object_rpy),
        support=replace(grasp.support, gap=gap),
    )


def quaternion_from_rpy(rpy: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The quaternion xyzw of URDF's fixed-axis roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    x, y, z, w = Rotation.from_euler("xyz", rpy).as_quat().tolist()
    return x, y, z, w


GRASPS: Mapping[str, NamedGrasp] = MappingProxyType(
    grasps_of(tomllib.loads((DATA / "grasps.toml").read_text(encoding="utf-8")))
)
"""All sixteen grasps by name, in the order of the paper's panels."""
