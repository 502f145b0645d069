"""MuJoCo models of a scene: the parts that have to be compiled, and the data from which every world sets its own values.

Worlds whose scenes have the same parts share one compiled model (`Layout`); all that an episode changes (sizes, poses, masses,
friction, the hand's parameters) are fields that `mujoco.batch.Batch.expand` gives every world a copy of.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.body.object_models import ObjectModel, Solid, principal_inertia
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.model import HPAC
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    GREEN,
    GREY,
    HAND_POSITION,
    PARTS,
    POST,
    TABLE_HALF_EXTENTS,
    WOOD,
    SceneSetup,
)
from hpac_gym.physics.mjcf import hand_mjcf, mass_matrix
from hpac_gym.physics.settings import HandSettings, WorldSettings

SLOTS = 8
"""Number of contacts of one part of the hand whose forces are added up, the strongest first."""
FORCE_SIZE = 4
"""Values of one slot: the number of contacts, and a force along the normal and two tangents."""
BRAKES = 5
"""Number of driving tendons, each of which has a brake."""
WRIST_STIFFNESS = 1e7
"""Stiffness of the servos that carry the palm [N/m]: weight and shake move it by less than 1 µm. Their force has no limit:
MuJoCo would apply one before a step, when so stiff a servo asks for thousands of newtons that it never exerts in the step."""
KINDS = {
    "sphere": int(mujoco.mjtGeom.mjGEOM_SPHERE),
    "capsule": int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    "cylinder": int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    "box": int(mujoco.mjtGeom.mjGEOM_BOX),
    "hull": int(mujoco.mjtGeom.mjGEOM_MESH),
}


@dataclass(frozen=True, slots=True)
class Layout:
    """The parts of a scene; worlds with the same ones share a compiled model."""

    armature: tuple[float, float, float]
    object: ObjectModel | str | None
    """None for the hand alone, "primitive" for any single solid along the object's axes, "solids" for any number of primitives,
    an object that has hulls."""
    solids: int = 1
    """Number of the object's solids."""
    fixed: bool = False
    boxes: int = 0
    """Posts and walls of the support."""
    target: bool = False

    @classmethod
    def of(cls, setup: SceneSetup) -> Layout:
        """The parts that a setup needs."""
        armature, spec = setup.hand_settings.armature, setup.object
        if spec is None:
            return cls(armature, None)
        kind: ObjectModel | str = "primitive"
        if spec.model is not None and not is_straight(spec.model):
            kind = spec.model if spec.model.has_hulls else "solids"
        number = 1 if spec.model is None else len(spec.model.solids)
        boxes = 0 if setup.fixed else _number_of_boxes(setup.support or POST)
        return cls(armature, kind, number, setup.fixed, boxes, setup.target is not None and not setup.fixed)


@cache
def _number_of_boxes(support: Support) -> int:
    return len(support.boxes(1.0))


@cache
def is_straight(model: ObjectModel) -> bool:
    """True if an object is one primitive along the object's axes."""
    alone = len(model.solids) == 1 and not model.has_hulls
    return alone and np.allclose(model.inertia, np.diag(np.diag(model.inertia)), atol=1e-12)


@lru_cache(maxsize=64)
def inertia_of_hand(geometry: Geometry, armature: tuple[float, float, float]) -> Array:
    """Joint-space inertia of a hand of the nominal model at half stroke, shape (15, 15) [kg·m²]."""
    return mass_matrix(geometry, armature, HPAC.synergy_max / 2)


@dataclass(frozen=True, slots=True)
class Geoms:
    """MuJoCo's numbers of those k solids of an object that are primitives; a hull's are compiled."""

    index: NDArray[np.intp]
    """Number of each primitive among the object's solids, shape (k,)."""
    kind: Array
    """MuJoCo's number of the shape, shape (k,)."""
    size: Array
    """Shape (k, 3) [m]."""
    place: Array
    """Shape (k, 3) [m]."""
    quaternion: Array
    """wxyz, shape (k, 4)."""
    half: Array
    """Half extents of the box around each one along its own axes, shape (k, 3) [m]."""
    radius: Array
    """Radius of the ball around each one, shape (k,) [m]."""


@lru_cache(maxsize=1024)
def geoms_of(shape: str, half_extents: tuple[float, float, float], model: ObjectModel | None, scale: float) -> Geoms:
    """The solids of an object, by the fields of its `ObjectSpec`."""
    if model is None:
        x, y, z = (2 * side for side in half_extents)
        solids: tuple[Solid, ...] = (Solid(shape, 1.0, (x, y, z), np.zeros(3), np.eye(3)),)
    else:
        solids = tuple(solid for solid in model.solids if solid.hull is None)
    index = range(1) if model is None else [index for index, solid in enumerate(model.solids) if solid.hull is None]
    half = np.array([[scale * side / 2 for side in solid.size] for solid in solids]).reshape(-1, 3)
    return Geoms(
        np.array(index, dtype=np.intp),
        np.array([KINDS[solid.kind] for solid in solids]),
        np.array([geom_size(solid, scale) for solid in solids]).reshape(-1, 3),
        np.array([scale * solid.center for solid in solids]).reshape(-1, 3),
        np.array([quaternion_from_matrix(solid.rotation) for solid in solids]).reshape(-1, 4),
        half,
        np.array([_reach(solid.kind, *sides) for solid, sides in zip(solids, half.tolist(), strict=True)]),
    )


def _reach(kind: str, x: float, y: float, z: float) -> float:
    """Radius of the ball around a solid of these half sizes [m]."""
    return {"sphere": x, "capsule": z, "cylinder": math.hypot(x, z), "box": math.hypot(x, y, z)}[kind]


@cache
def _mass_of(model: ObjectModel) -> tuple[Array, Array]:
    """Centre of mass and inertia about it."""
    return model.center_of_mass, model.inertia


@lru_cache(maxsize=64)
def inertia_of(spec: ObjectSpec) -> tuple[Array, Array, Array]:
    """Centre of mass, shape (3,) [m], principal moments about it, shape (3,) [kg·m²], and their axes, quaternion wxyz."""
    straight, centre = np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3)
    if spec.model is None:
        x, y, z = (2 * half for half in spec.half_extents)
        return centre, np.array(principal_inertia(spec.shape, spec.mass, (x, y, z))), straight
    centre, inertia = _mass_of(spec.model)
    inertia = inertia * (spec.mass / spec.model.mass * spec.scale**2)
    if is_straight(spec.model):
        return spec.scale * centre, np.diag(inertia), straight
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return spec.scale * centre, moments, quaternion_from_matrix(axes)


def geom_size(solid: Solid, scale: float) -> Array:
    """MuJoCo's size of a solid: half extents of a box, radius and half length of round ones, shape (3,) [m]."""
    x, y, z = (scale * side / 2 for side in solid.size)
    return np.array({"box": (x, y, z), "sphere": (x, 0.0, 0.0), "cylinder": (x, z, 0.0), "capsule": (x, z - x, 0.0)}[solid.kind])


def quaternion_from_matrix(rotation: Array) -> Array:
    """Quaternion wxyz of a rotation matrix, shape (4,)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion


@lru_cache(maxsize=16)
def build(layout: Layout, settings: WorldSettings, visuals: bool, geometry: Geometry) -> mujoco.MjModel:
    """Compile the model of a layout; poses and sizes that worlds set for themselves are placeholders.

    Whoever asks for the same model again gets the same one: worlds change their own copies of its fields, never the model.

    Args:
        layout: the parts of the scene.
        settings: of the world.
        visuals: draw what does not collide.
        geometry: of the hand's body, the one part of the model that is no placeholder.
    """
    hand = replace(HandSettings(), armature=layout.armature)
    root = Xml.fromstring(hand_mjcf(geometry, hand, on_wrist=layout.object is not None))
    option, world, actuators = root.find("option"), root.find("worldbody"), root.find("actuator")
    option.attrib |= {"timestep": repr(settings.dt), "gravity": f"0 0 {-settings.gravity!r}"}
    # What a drive is told runs ahead of its servo, and so beyond the servo's range (see `Group.lead`).
    contact = "enable" if settings.collisions else "disable"
    Xml.SubElement(option, "flag", clampctrl="disable", contact=contact)
    base = next(body for body in world.iter("body") if body.get("name") in ("wrist", "palm"))
    base.set("pos", " ".join(map(repr, HAND_POSITION.tolist())))
    if not visuals:
        for body in list(world.iter("body")):
            for geom in [geom for geom in body.findall("geom") if geom.get("class") == "drawn"]:
                body.remove(geom)
    _add_brakes(actuators)
    for slide in actuators.findall("position"):
        slide.attrib |= {"kp": repr(WRIST_STIFFNESS), "dampratio": "0", "forcelimited": "false"}
    if layout.object is not None:
        _add_object(root, world, layout)
        if not layout.fixed:
            _add_supports(world, layout)
        _add_sensors(Xml.SubElement(root, "sensor"), layout)
    model = mujoco.MjModel.from_xml_string(Xml.tostring(root, encoding="unicode"))
    # These flags say that a frame coincides with its body's; worlds move theirs.
    model.geom_sameframe[:] = 0
    return model


def _add_brakes(actuators: Xml.Element) -> None:
    """Add the damping that a slack drive keeps (`Damping.overrun`): it opposes flexion that is faster than the servo's."""
    for drive in actuators.findall("general")[:BRAKES]:
        Xml.SubElement(
            actuators, "general", name=f"{drive.get('name')}_brake", tendon=drive.get("tendon"), gaintype="fixed",
            biastype="affine", gainprm="0", biasprm="0 0 0", forcerange="0 1000",
        )  # fmt: skip


def _add_object(root: Xml.Element, world: Xml.Element, layout: Layout) -> None:
    item = Xml.SubElement(world, "body", name="object")
    if not layout.fixed:
        Xml.SubElement(item, "freejoint", name="object")
    if layout.object != "primitive":
        item.set("simple", "false")  # worlds give it their own axes of inertia
    Xml.SubElement(item, "inertial", pos="0 0 0", mass="0.1", diaginertia="1e-4 1e-4 1e-4")
    solids = layout.object.solids if isinstance(layout.object, ObjectModel) else (None,) * layout.solids
    for index, solid in enumerate(solids):
        geom = Xml.SubElement(item, "geom", {"class": "body"}, name=f"object_{index}", priority="1")
        if solid is None or solid.hull is None:
            geom.attrib |= {"type": "box", "size": "0.03 0.03 0.03"}
        else:
            Xml.SubElement(root.find("asset"), "mesh", name=f"hull_{index}", vertex=_text(solid.hull.vertices.ravel()))
            place = {"pos": _text(solid.center), "quat": _text(quaternion_from_matrix(solid.rotation))}
            geom.attrib |= {"type": "mesh", "mesh": f"hull_{index}", **place}


def _add_supports(world: Xml.Element, layout: Layout) -> None:
    support = Xml.SubElement(world, "body", name="support")
    boxes = [(f"support_{index}", GREY, (0.02, 0.02, 0.02)) for index in range(layout.boxes)]
    for name, color, size in (*boxes, ("table", WOOD, TABLE_HALF_EXTENTS)):
        _add_box(support, name, color, size)
    if layout.target:
        _add_box(Xml.SubElement(world, "body", name="target"), "target", GREEN, (0.02, 0.02, 0.02))


def _add_box(body: Xml.Element, name: str, color: tuple[float, ...], size: tuple[float, ...]) -> None:
    numbers = {"type": "box", "size": _text(size), "rgba": _text(color), "priority": "2"}
    Xml.SubElement(body, "geom", {"class": "body", "name": name, **numbers})


def _add_sensors(sensor: Xml.Element, layout: Layout) -> None:
    for part in PARTS:
        owner = {"body1": "palm"} if part == "palm" else {"subtree1": HPAC_GEOMETRY.digit(part).phalanges[0].link}
        slots = {"num": str(SLOTS), "data": "found force", "reduce": "maxforce"}
        Xml.SubElement(sensor, "contact", {"name": part, **owner, "body2": "object", **slots})
    for name in ("support", "target") if layout.target else () if layout.fixed else ("support",):
        Xml.SubElement(sensor, "contact", {"name": name, "body1": name, "body2": "object", "data": "found"})


def _text(values: Array | tuple[float, ...] | list[float]) -> str:
    return " ".join(map(repr, map(float, values)))
