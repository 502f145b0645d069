"""MuJoCo models of a scene: the parts that have to be compiled, and the data from which every world sets its own values.

Worlds whose scenes have the same parts share one compiled model (`Layout`); all that an episode changes (sizes, poses, masses,
friction, the hand's parameters) are fields that `mujoco.batch.Batch.expand` gives every world a copy of.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np

from hpac_gym.body.geometry import load_geometry
from hpac_gym.body.object_models import ObjectModel, Solid, load_object_models
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.model import HPAC
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    GREEN,
    GREY,
    HAND_POSITION,
    PARTS,
    POST_HALF_WIDTH,
    TABLE_HALF_EXTENTS,
    TARGET_HALF_WIDTH,
    WOOD,
    SceneSetup,
    matrix_from_quaternion,
)
from hpac_gym.physics.mjcf import hand_mjcf, mass_matrix, root_frames
from hpac_gym.physics.settings import HandSettings, WorldSettings

GEOMETRY = load_geometry()
ROOTS = root_frames(GEOMETRY)
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
}


@dataclass(frozen=True, slots=True)
class Layout:
    """The parts of a scene; worlds with the same ones share a compiled model."""

    armature: tuple[float, float, float]
    object: str | None
    """None for the hand alone, "primitive" for any single solid along the object's axes, else the name of an object."""
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
        name = "primitive" if spec.model is None or is_straight(spec.model) else spec.model
        boxes = 0 if setup.fixed else len(support_of(setup).boxes(1.0))
        return cls(armature, name, setup.fixed, boxes, setup.target is not None and not setup.fixed)


@cache
def object_models() -> dict[str, ObjectModel]:
    """Every named object."""
    return load_object_models()


@cache
def is_straight(name: str) -> bool:
    """Whether a named object is one solid along the object's axes."""
    model = object_models()[name]
    return len(model.solids) == 1 and np.allclose(model.inertia, np.diag(np.diag(model.inertia)), atol=1e-12)


@cache
def nominal_inertia(armature: tuple[float, float, float]) -> Array:
    """Joint-space inertia of the hand at half stroke, shape (15, 15) [kg·m²]."""
    return mass_matrix(GEOMETRY, armature, HPAC.synergy_max / 2)


def solids_of(spec: ObjectSpec) -> tuple[Solid, ...]:
    """The solids of an object at scale 1."""
    if spec.model is not None:
        return object_models()[spec.model].solids
    x, y, z = (2 * half for half in spec.half_extents)
    return (Solid(spec.shape, spec.mass, (x, y, z), np.zeros(3), np.eye(3)),)


def inertia_of(spec: ObjectSpec) -> tuple[Array, Array]:
    """Centre of mass, shape (3,) [m], and inertia about it, shape (3, 3) [kg·m²], in the object's axes."""
    if spec.model is None:
        return np.zeros(3), solids_of(spec)[0].inertia
    model = object_models()[spec.model]
    return spec.scale * model.center_of_mass, model.inertia * (spec.mass / model.mass * spec.scale**2)


def support_of(setup: SceneSetup) -> Support:
    """The support of a setup."""
    return setup.support or Support((POST_HALF_WIDTH, POST_HALF_WIDTH))


def support_boxes(setup: SceneSetup) -> tuple[list[tuple[Array, Array]], Array, tuple[Array, Array] | None, tuple[float, ...]]:
    """Half extents and centres in the world of the posts and walls; the table's centre; the target's post; the posts' turn.

    Returns:
        Posts and walls, shapes (3,) and (3,) each [m]; centre of the table, shape (3,) [m]; half extents and centre of the
        target's post or None [m]; quaternion xyzw of posts and walls.
    """
    centre = HAND_POSITION + setup.hand_rotation @ setup.position
    reach = np.abs(matrix_from_quaternion(setup.object_quaternion)[2]) @ setup.object.half_extents
    support = support_of(setup)
    turn = setup.object_turn[1] if setup.support else (0.0, 0.0, 0.0, 1.0)
    floor, turned = support.table_height, matrix_from_quaternion(turn)
    below = np.array([centre[0], centre[1], floor])
    boxes = [(np.array(half), below + turned @ place) for half, place in support.boxes(centre[2] - reach - floor)]
    target = None
    if setup.target is not None:
        x, y, z = HAND_POSITION + setup.hand_rotation @ setup.target
        half = (z - reach) / 2
        target = np.array([TARGET_HALF_WIDTH, TARGET_HALF_WIDTH, half]), np.array([x, y, half])
    return boxes, below - [0.0, 0.0, TABLE_HALF_EXTENTS[2]], target, turn


def geom_size(solid: Solid, scale: float) -> Array:
    """MuJoCo's size of a solid: half extents of a box, radius and half length of round ones, shape (3,) [m]."""
    x, y, z = (scale * side / 2 for side in solid.size)
    return np.array({"box": (x, y, z), "sphere": (x, 0.0, 0.0), "cylinder": (x, z, 0.0), "capsule": (x, z - x, 0.0)}[solid.kind])


def quaternion_from_matrix(rotation: Array) -> Array:
    """Quaternion wxyz of a rotation matrix, shape (4,)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    return quaternion


def build(layout: Layout, settings: WorldSettings, visuals: bool) -> mujoco.MjModel:
    """Compile the model of a layout; poses and sizes that worlds set for themselves are placeholders."""
    hand = replace(HandSettings(), armature=layout.armature)
    root = Xml.fromstring(hand_mjcf(GEOMETRY, hand, on_wrist=layout.object is not None))
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
        _add_object(world, layout)
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


def _add_object(world: Xml.Element, layout: Layout) -> None:
    item = Xml.SubElement(world, "body", name="object")
    if not layout.fixed:
        Xml.SubElement(item, "freejoint", name="object")
    solids = [None] if layout.object == "primitive" else object_models()[layout.object].solids
    if solids == [None]:
        Xml.SubElement(item, "inertial", pos="0 0 0", mass="0.1", diaginertia="1e-4 1e-4 1e-4")
    else:
        center, inertia = object_models()[layout.object].center_of_mass, object_models()[layout.object].inertia
        entries = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
        item.set("simple", "false")  # whatever its inertia is like: worlds give it their own axes
        numbers = {"pos": _text(center), "mass": "0.1", "fullinertia": _text(entries)}
        Xml.SubElement(item, "inertial", numbers)
    for index, solid in enumerate(solids):
        geom = Xml.SubElement(item, "geom", {"class": "body"}, name=f"object_{index}", priority="1")
        if solid is None:
            geom.attrib |= {"type": "box", "size": "0.03 0.03 0.03"}
        else:
            size, quaternion = geom_size(solid, 1.0), quaternion_from_matrix(solid.rotation)
            geom.attrib |= {"type": solid.kind, "size": _text(size), "pos": _text(solid.center), "quat": _text(quaternion)}


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
        owner = {"body1": "palm"} if part == "palm" else {"subtree1": GEOMETRY.digit(part).phalanges[0].link}
        slots = {"num": str(SLOTS), "data": "found force", "reduce": "maxforce"}
        Xml.SubElement(sensor, "contact", {"name": part, **owner, "body2": "object", **slots})
    for name in ("support", "target") if layout.target else () if layout.fixed else ("support",):
        Xml.SubElement(sensor, "contact", {"name": name, "body1": name, "body2": "object", "data": "found"})


def _text(values: Array | tuple[float, ...] | list[float]) -> str:
    return " ".join(map(repr, map(float, values)))
