"""The sixteen named grasps as data: object, hand shape, wrist pose, support, noise and held-out
variants.

The numbers are in ``data/grasps.toml``; the names are those of the grasp shapes in
`hpac_gym.model.POSTURES`."""

import difflib
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.resources import files
from types import MappingProxyType
from typing import Any

import numpy as np

from hpac_gym.body.object_models import ObjectModel, load_object_models
from hpac_gym.body.objects import Support
from hpac_gym.errors import HpacError, ParameterError
from hpac_gym.model import HPAC, SERVOS
from hpac_gym.model.checks import Array, as_bounded_array

FAMILIES = ("power", "precision", "lateral", "tool")
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

    def __post_init__(self) -> None:
        factors = (self.scale, self.mass, self.friction)
        if not min(factors) > 0:
            raise ParameterError(
                f"scale, mass and friction of a variant are {factors}, must be greater than 0"
            )


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


def grasps_from_toml(
    text: str | dict[str, Any],
    models: Mapping[str, ObjectModel],
    closed: Mapping[str, Array] = MappingProxyType({}),
) -> dict[str, NamedGrasp]:
    """Grasps described by a TOML text or its parsed tables.

    Args:
        text: the text, or its tables.
        models: the objects by name.
        closed: closed hand shapes of grasps that have none in the text, shape (6,) each [rad].

    Raises:
        ParameterError: Not TOML, an unknown object or family, or a field that is missing, unknown
            or out of bounds.
    """
    try:
        table = tomllib.loads(text) if isinstance(text, str) else dict(text)
        common = _variants(table.pop("held_out", {}), models)
    except (tomllib.TOMLDecodeError, TypeError) as error:
        raise ParameterError(f"grasps: {error}") from None
    found = {}
    for name, entry in table.items():
        with refusing(f"grasp {name}"):
            entry = {"closed": closed[name].tolist()} | entry if name in closed else dict(entry)
            found[name] = _grasp(name, entry, models, common)
    return found


@contextmanager
def refusing(name: str) -> Iterator[None]:
    """Refuse a table of that name if a field is missing, unknown or out of bounds.

    Raises:
        ParameterError: It is.
    """
    try:
        yield
    except KeyError as error:
        raise ParameterError(f"{name}: {error.args[0]} is missing") from None
    except (TypeError, ValueError) as error:
        raise ParameterError(f"{name}: {error}") from None


def with_tuples(table: Mapping[str, Any]) -> dict[str, Any]:
    """A table whose lists are tuples."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}


def _grasp(
    name: str, entry: dict[str, Any], models: Mapping[str, ObjectModel], common: dict[str, Variant]
) -> NamedGrasp:
    model = _model(entry.pop("object"), models)
    family = entry.pop("family")
    if family not in FAMILIES:
        raise ParameterError(f"family {family!r} is not one of {', '.join(FAMILIES)}")
    held_out = common | _variants(entry.pop("held_out", {}), models)
    grasp = NamedGrasp(
        name=name,
        family=family,
        about=entry.pop("about"),
        object=model,
        friction=float(entry.pop("friction")),
        hand_rpy=tuple(np.deg2rad(_vector(entry, "hand_rpy_deg")).tolist()),
        object_rpy=tuple(np.deg2rad(_vector(entry, "object_rpy_deg")).tolist()),
        position=_vector(entry, "position"),
        preshape=_synergy(entry, "preshape"),
        closed=_synergy(entry, "closed"),
        support=Support(**with_tuples(entry.pop("support"))),
        position_noise=_vector(entry, "position_noise"),
        yaw_noise=float(entry.pop("yaw_noise")),
        held_out=MappingProxyType(held_out),
    )
    if entry:
        raise ParameterError(f"unknown fields {', '.join(entry)}")
    return grasp


def _variants(
    table: Mapping[str, dict[str, Any]], models: Mapping[str, ObjectModel]
) -> dict[str, Variant]:
    found = {}
    for name, entry in table.items():
        known = {"object": _model(entry["object"], models)} if "object" in entry else {}
        found[name] = Variant(**entry | known)
    return found


def _model(name: str, models: Mapping[str, ObjectModel]) -> ObjectModel:
    if name not in models:
        raise ParameterError(f"object {name!r} is not one of {', '.join(models)}")
    return models[name]


def _vector(entry: dict[str, Any], key: str) -> Vector:
    values = entry.pop(key)
    if not (isinstance(values, list) and len(values) == 3):
        raise ParameterError(f"{key} must be three numbers, not {values!r}")
    x, y, z = map(float, values)
    return x, y, z


def _synergy(entry: dict[str, Any], key: str) -> Array:
    synergy = as_bounded_array(
        entry.pop(key), HPAC.synergy_min, HPAC.synergy_max, SERVOS, key, "rad"
    )
    synergy.setflags(write=False)
    return synergy


GRASPS: Mapping[str, NamedGrasp] = MappingProxyType(
    grasps_from_toml(
        (files("hpac_gym.tasks") / "data" / "grasps.toml").read_text(encoding="utf-8"),
        load_object_models(),
    )
)
"""All sixteen grasps by name, in the order of the paper's panels."""
