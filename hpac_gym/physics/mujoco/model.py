"""MuJoCo models of a scene: the parts that must be compiled, and the data from which every world
sets its own values.

Worlds with the same `Layout` share one compiled model; everything that varies between episodes
(sizes, poses, masses, friction, the hand's parameters) is a field that `mujoco.batch.Batch.expand`
copies for every world."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import Any
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.body.object_models import ObjectModel, principal_inertia
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.model import DIGITS, HPAC
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
"""Largest number of contacts per part of the hand whose forces are summed, strongest first."""
FORCE_SIZE = 4
"""Values of one slot: the number of contacts, and a force along the normal and two tangents."""
WRIST_STIFFNESS = 1e7
"""Stiffness of the servos that hold the palm [N/m]: weight and shake deflect it by less than 1 µm.
Their force is not limited: MuJoCo applies limits before a step, when so stiff a servo requests
thousands of newtons that it never exerts in the step."""
LIMITED_WRIST_STIFFNESS = 2e4
"""Stiffness of the servos of a wrist whose force is limited (`WorldSettings.wrist_effort`) [N/m].
"""
KINDS = {
    "sphere": int(mujoco.mjtGeom.mjGEOM_SPHERE),
    "capsule": int(mujoco.mjtGeom.mjGEOM_CAPSULE),
    "cylinder": int(mujoco.mjtGeom.mjGEOM_CYLINDER),
    "box": int(mujoco.mjtGeom.mjGEOM_BOX),
    "hull": int(mujoco.mjtGeom.mjGEOM_MESH),
}
_ALONE = np.zeros(1, dtype=np.intp)
_ORIGIN = np.zeros(3)
_STRAIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Layout:
    """The parts of a scene; worlds with equal layouts share a compiled model."""

    armature: tuple[float, float, float]
    object: ObjectModel | str | None
    """None for the hand alone, "primitive" for a single axis-aligned solid, "solids" for other
    objects made of primitives, or the model itself if it has hulls."""
    solids: int = 1
    """Number of the object's solids."""
    fixed: bool = False
    boxes: int = 0
    """Number of posts and walls of the support."""
    target: bool = False

    @classmethod
    def of(cls, setup: SceneSetup) -> Layout:
        """Layout of a setup."""
        armature = setup.hand_settings.armature
        spec = setup.object
        if spec is None:
            return cls(armature, None)
        kind: ObjectModel | str = "primitive"
        if spec.model is not None and not is_straight(spec.model):
            kind = spec.model if spec.model.has_hulls else "solids"
        number = 1 if spec.model is None else len(spec.model.solids)
        boxes = 0 if setup.fixed else _number_of_boxes(setup.support)
        return cls(
            armature, kind, number, setup.fixed, boxes, setup.target is not None and not setup.fixed
        )


@cache
def _number_of_boxes(support: Support | None) -> int:
    return len((support or POST).boxes(1.0))


@cache
def is_straight(model: ObjectModel) -> bool:
    """True if an object is a single primitive aligned with the object's axes."""
    alone = len(model.solids) == 1 and not model.has_hulls
    return alone and np.allclose(model.inertia, np.diag(np.diag(model.inertia)), atol=1e-12)


@lru_cache(maxsize=64)
def inertia_of_hand(geometry: Geometry, armature: tuple[float, float, float]) -> Array:
    """Joint-space inertia of a hand of the nominal model at half stroke, shape (15, 15) [kg·m²]."""
    return mass_matrix(geometry, armature, HPAC.synergy_max / 2)


def geoms_of(spec: ObjectSpec) -> tuple[NDArray[np.intp], dict[str, Any]]:
    """Indices of the k primitive solids among an object's, and their values of MuJoCo's geom
    fields; hulls are compiled.
    """
    if spec.model is not None:
        return _geoms_of_model(spec.model, spec.scale)
    return _ALONE, _geom_fields(spec.shape, *spec.half_extents)


@lru_cache(maxsize=1024)
def _geoms_of_model(model: ObjectModel, scale: float) -> tuple[NDArray[np.intp], dict[str, Any]]:
    index = [index for index, solid in enumerate(model.solids) if solid.hull is None]
    rows = []
    for solid in (model.solids[i] for i in index):
        place = scale * solid.center
        turn = quaternion_from_matrix(solid.rotation)
        rows.append(
            _geom_fields(solid.kind, *(scale * side / 2 for side in solid.size), place, turn)
        )
    return np.array(index, dtype=np.intp), {
        name: np.array([row[name] for row in rows]) for name in rows[0]
    } if rows else {}


def _geom_fields(
    kind: str, x: float, y: float, z: float, place: Array = _ORIGIN, turn: Array = _STRAIGHT
) -> dict[str, Any]:
    """MuJoCo's geom fields of a solid with these half-extents [m], at a place [m], turned by a
    quaternion wxyz.
    """
    size, reach = size_of(kind, x, y, z)
    numbers = {"geom_type": KINDS[kind], "geom_size": size, "geom_pos": place, "geom_quat": turn}
    return numbers | {"geom_rbound": reach, "geom_aabb": (0.0, 0.0, 0.0, x, y, z)}


def size_of(kind: str, x: float, y: float, z: float) -> tuple[tuple[float, float, float], float]:
    """MuJoCo's size of a solid with these half-extents (radius and half length of round ones), and
    its bounding radius [m].
    """
    match kind:
        case "box":
            return (x, y, z), math.hypot(x, y, z)
        case "sphere":
            return (x, 0.0, 0.0), x
        case "cylinder":
            return (x, z, 0.0), math.hypot(x, z)
    return (x, z - x, 0.0), z


@cache
def _mass_of(model: ObjectModel) -> tuple[Array, Array]:
    """Centre of mass, shape (3,) [m], and inertia about it, shape (3, 3) [kg·m²]."""
    return model.center_of_mass, model.inertia


@lru_cache(maxsize=64)
def inertia_of(spec: ObjectSpec) -> tuple[Array, Array, Array]:
    """Centre of mass, shape (3,) [m], principal moments about it, shape (3,) [kg·m²], and their
    axes, quaternion wxyz.
    """
    if spec.model is None:
        x, y, z = (2 * half for half in spec.half_extents)
        return _ORIGIN, np.array(principal_inertia(spec.shape, spec.mass, (x, y, z))), _STRAIGHT
    centre, inertia = _mass_of(spec.model)
    inertia = inertia * (spec.mass / spec.model.mass * spec.scale**2)
    if is_straight(spec.model):
        return spec.scale * centre, np.diag(inertia), _STRAIGHT
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return spec.scale * centre, moments, quaternion_from_matrix(axes)


def quaternion_from_matrix(rotation: Array) -> Array:
    """Quaternion wxyz of a rotation matrix, shape (4,)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion


@lru_cache(maxsize=16)
def build(
    layout: Layout, settings: WorldSettings, visuals: bool, geometry: Geometry
) -> mujoco.MjModel:
    """Compile the model of a layout, with placeholders for the poses and sizes that worlds set.

    Models are cached and shared: worlds modify their own copies of the fields, never the model.

    Args:
        layout: the parts of the scene.
        settings: settings of the world.
        visuals: include visual-only geoms.
        geometry: geometry of the hand, which is not a placeholder.
    """
    hand = replace(HandSettings(), armature=layout.armature)
    root = Xml.fromstring(hand_mjcf(geometry, hand, on_wrist=layout.object is not None))
    option = root.find("option")
    world = root.find("worldbody")
    actuators = root.find("actuator")
    option.attrib |= {"timestep": repr(settings.dt), "gravity": f"0 0 {-settings.gravity!r}"}
    # A drive's control leads its servo, and can therefore exceed the servo's range (see
    # `Group.lead`).
    contact = "enable" if settings.collisions else "disable"
    Xml.SubElement(option, "flag", clampctrl="disable", contact=contact)
    base = next(body for body in world.iter("body") if body.get("name") in ("wrist", "palm"))
    base.set("pos", " ".join(map(repr, HAND_POSITION.tolist())))
    if not visuals:
        for body in list(world.iter("body")):
            for geom in [geom for geom in body.findall("geom") if geom.get("class") == "drawn"]:
                body.remove(geom)
    _add_brakes(actuators)
    wrist = {"kp": repr(WRIST_STIFFNESS), "dampratio": "0", "forcelimited": "false"}
    if effort := settings.wrist_effort:
        wrist = {"kp": repr(LIMITED_WRIST_STIFFNESS), "forcerange": exact_text((-effort, effort))}
    for slide in actuators.findall("position"):
        slide.attrib |= wrist
    if layout.object is not None:
        _add_object(root, world, layout)
        if not layout.fixed:
            _add_supports(world, layout)
        _add_sensors(Xml.SubElement(root, "sensor"), layout)
    model = mujoco.MjModel.from_xml_string(Xml.tostring(root, encoding="unicode"))
    # These flags state that a frame coincides with its body's; worlds move theirs.
    model.geom_sameframe[:] = 0
    if settings.torsion is not None:
        model.geom_friction[:, 1] = settings.torsion
    return model


def _add_brakes(actuators: Xml.Element) -> None:
    """Add the damping that a slack drive keeps (`Damping.overrun`): it opposes flexion that is
    faster than the servo's.
    """
    for drive in actuators.findall("general")[: len(DIGITS)]:
        Xml.SubElement(
            actuators,
            "general",
            name=f"{drive.get('name')}_brake",
            tendon=drive.get("tendon"),
            gaintype="fixed",
            biastype="affine",
            gainprm="0",
            biasprm="0 0 0",
            forcerange="0 1000",
        )


def _add_object(root: Xml.Element, world: Xml.Element, layout: Layout) -> None:
    item = Xml.SubElement(world, "body", name="object")
    if not layout.fixed:
        Xml.SubElement(item, "freejoint", name="object")
    if layout.object != "primitive":
        item.set("simple", "false")  # worlds set their own inertia axes
    Xml.SubElement(item, "inertial", pos="0 0 0", mass="0.1", diaginertia="1e-4 1e-4 1e-4")
    solids = (
        layout.object.solids if isinstance(layout.object, ObjectModel) else (None,) * layout.solids
    )
    for index, solid in enumerate(solids):
        geom = Xml.SubElement(item, "geom", {"class": "body"}, name=f"object_{index}", priority="1")
        if solid is None or solid.hull is None:
            geom.attrib |= {"type": "box", "size": "0.03 0.03 0.03"}
        else:
            Xml.SubElement(
                root.find("asset"),
                "mesh",
                name=f"hull_{index}",
                vertex=exact_text(solid.hull.vertices.ravel()),
            )
            place = {
                "pos": exact_text(solid.center),
                "quat": exact_text(quaternion_from_matrix(solid.rotation)),
            }
            geom.attrib |= {"type": "mesh", "mesh": f"hull_{index}", **place}


def _add_supports(world: Xml.Element, layout: Layout) -> None:
    support = Xml.SubElement(world, "body", name="support")
    boxes = [(f"support_{index}", GREY, (0.02, 0.02, 0.02)) for index in range(layout.boxes)]
    for name, color, size in (*boxes, ("table", WOOD, TABLE_HALF_EXTENTS)):
        _add_box(support, name, color, size)
    if layout.target:
        _add_box(Xml.SubElement(world, "body", name="target"), "target", GREEN, (0.02, 0.02, 0.02))


def _add_box(
    body: Xml.Element, name: str, color: tuple[float, ...], size: tuple[float, ...]
) -> None:
    numbers = {"type": "box", "size": exact_text(size), "rgba": exact_text(color), "priority": "2"}
    Xml.SubElement(body, "geom", {"class": "body", "name": name, **numbers})


def _add_sensors(sensor: Xml.Element, layout: Layout) -> None:
    for part in PARTS:
        owner = (
            {"body1": "palm"}
            if part == "palm"
            else {"subtree1": HPAC_GEOMETRY.digit(part).phalanges[0].link}
        )
        slots = {"num": str(SLOTS), "data": "found force", "reduce": "maxforce"}
        Xml.SubElement(sensor, "contact", {"name": part, **owner, "body2": "object", **slots})
    for name in ("support", "target") if layout.target else () if layout.fixed else ("support",):
        Xml.SubElement(
            sensor, "contact", {"name": name, "body1": name, "body2": "object", "data": "found"}
        )


def exact_text(values: Iterable[float]) -> str:
    """Numbers with all their digits, as an XML attribute."""
    return " ".join(map(repr, map(float, values)))
