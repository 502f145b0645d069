"""MuJoCo models of a scene: the parts that must be compiled, and the addresses of their elements.

Worlds with the same `Layout` share one compiled model; everything that varies between episodes
(sizes, poses, masses, friction, the hand's parameters) is a field that `mujoco.batch.Batch.expand`
copies for every world."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, lru_cache
from xml.etree import ElementTree as Xml

import mujoco
import numpy as np

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.body.object_models import ObjectModel, Solid
from hpac_gym.model import DIGITS, JOINTS
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, PARTS, SceneSetup
from hpac_gym.physics.mjcf import hand_mjcf
from hpac_gym.physics.settings import HandSettings, WorldSettings
from hpac_gym.physics.supports import COLORS, POST, TABLE_HALF_EXTENTS

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
        if setup.fixed:
            return cls(armature, kind, number, fixed=True)
        boxes = len((setup.support or POST).boxes(1.0))
        return cls(armature, kind, number, boxes=boxes, target=setup.target is not None)


@cache
def is_straight(model: ObjectModel) -> bool:
    """True if an object is a single primitive aligned with the object's axes."""
    alone = len(model.solids) == 1 and not model.has_hulls
    return alone and np.allclose(model.inertia, np.diag(np.diag(model.inertia)), atol=1e-12)


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
    hand = HandSettings(armature=layout.armature)
    root = Xml.fromstring(hand_mjcf(geometry, hand, on_wrist=layout.object is not None))
    world = root.find("worldbody")
    actuators = root.find("actuator")
    option = root.find("option")
    option.attrib |= {
        "timestep": exact_text([settings.dt]),
        "gravity": exact_text([0, 0, -settings.gravity]),
    }
    # A drive's control leads its servo, and can therefore exceed the servo's range (see
    # `Parameters.lead`).
    contact = "enable" if settings.collisions else "disable"
    Xml.SubElement(option, "flag", clampctrl="disable", contact=contact)
    world.find("body").set("pos", exact_text(HAND_POSITION))
    if not visuals:
        for body in list(world.iter("body")):
            for geom in [geom for geom in body.findall("geom") if geom.get("class") == "drawn"]:
                body.remove(geom)
    # The damping that a slack drive keeps (`Damping.overrun`) opposes flexion that is faster than the
    # servo's, of a taut drive too, in addition to its own damping.
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
    wrist = {"kp": repr(WRIST_STIFFNESS), "dampratio": "0", "forcelimited": "false"}
    if effort := settings.wrist_effort:
        wrist = {"kp": repr(LIMITED_WRIST_STIFFNESS), "forcerange": exact_text((-effort, effort))}
    for slide in actuators.findall("position"):
        slide.attrib |= wrist
    if layout.object is not None:
        _add_scene(root, layout)
    model = mujoco.MjModel.from_xml_string(Xml.tostring(root, encoding="unicode"))
    # These flags state that a frame coincides with its body's; worlds move theirs.
    model.geom_sameframe[:] = 0
    if settings.torsion is not None:
        model.geom_friction[:, 1] = settings.torsion
    return model


def _add_scene(root: Xml.Element, layout: Layout) -> None:
    """Add an object, what it stands on, and a sensor for each of its contacts."""
    standing = {}
    if not layout.fixed:
        standing["support"] = _box("support") * layout.boxes + _box("table")
    if layout.target:
        standing["target"] = _box("target")
    bodies = "".join(f'<body name="{name}">{boxes}</body>' for name, boxes in standing.items())
    digits = [HPAC_GEOMETRY.digit(name).phalanges[0].link for name in DIGITS]
    owners = ['body1="palm"', *(f'subtree1="{link}"' for link in digits)]
    sensors = "".join(
        f'<contact name="{part}" {owner} body2="object" num="{SLOTS}" data="found force" reduce="maxforce" />'
        for part, owner in zip(PARTS, owners, strict=True)
    ) + "".join(
        f'<contact name="{name}" body1="{name}" body2="object" data="found" />' for name in standing
    )
    # Worlds set their own inertia axes, but for a primitive.
    simple = "" if layout.object == "primitive" else 'simple="false"'
    scene = Xml.fromstring(
        f"""<mujoco>
          <worldbody>
            <body name="object" {simple}>
              {"" if layout.fixed else '<freejoint name="object" />'}
              <inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4" />
            </body>
            {bodies}
          </worldbody>
          <sensor>{sensors}</sensor>
        </mujoco>"""
    )
    root.extend(scene)
    item = scene.find("worldbody/body")
    for index in range(layout.solids):
        geom = {"class": "body", "name": f"object_{index}", "priority": "1"}
        if isinstance(layout.object, ObjectModel):
            add_solid(root, item, index, layout.object.solids[index], geom)
        else:
            Xml.SubElement(item, "geom", geom, type="box", size="0.03 0.03 0.03")


def _box(kind: str) -> str:
    """A box that stands in the world, whose size and place worlds set, but for the table's."""
    size = exact_text(TABLE_HALF_EXTENTS if kind == "table" else (0.02, 0.02, 0.02))
    return f'<geom class="body" type="box" size="{size}" rgba="{exact_text(COLORS[kind])}" priority="2" />'


def add_solid(
    root: Xml.Element, body: Xml.Element, index: int, solid: Solid, geom: dict[str, str]
) -> None:
    """Add a solid of an object to a body as a geom with more attributes; the corners of a hull
    become a mesh of the model.
    """
    turn = exact_text(quaternion_from_matrix(solid.rotation))
    geom = geom | {"pos": exact_text(solid.center), "quat": turn}
    if solid.hull is None:
        size, _ = size_of(solid.kind, *np.divide(solid.size, 2).tolist())
        geom |= {"type": solid.kind, "size": exact_text(size)}
    else:
        corners = exact_text(solid.hull.vertices.ravel())
        Xml.SubElement(root.find("asset"), "mesh", name=f"hull_{index}", vertex=corners)
        geom |= {"type": "mesh", "mesh": f"hull_{index}"}
    Xml.SubElement(body, "geom", geom)


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


def exact_text(values: Iterable[float]) -> str:
    """Numbers with all their digits, as an XML attribute."""
    return " ".join(map(repr, map(float, values)))


class Addresses:
    """Indices into the arrays of a compiled model that `build` made.

    Attributes:
        hinge: indices of `JOINTS` among the model's joints.
        joint: positions of `JOINTS` in qpos.
        dof: positions of `JOINTS` in qvel.
        object: position of the object in qpos; −1 without a movable object.
        object_body: index of the object's body; −1 without an object.
        pose: positions in qpos of `JOINTS`, of the three slides of the wrist, and of the movable
            object's place and quaternion, as far as there are any.
        motion: positions in qvel of `JOINTS`, and of the movable object's velocity and spin.
        palm: index of the palm's body.
        hand: bodies of the hand.
        hand_geoms: geoms of the hand.
        object_geoms: geoms of the object.
        boxes: geoms of posts and walls, then the table, then the target's post.
        guides: sites of the drives' guides, fixed and moving, by digit, shape (5, 2).
        fixed: couplings, then springs.
        drives: spatial tendons, by digit.
        wraps: positions of the fixed tendons' coefficients in wrap_prm.
        touch: positions in sensordata of the normal forces in the slots of `PARTS`, then of the numbers
            of contacts of the object with each of them, with its support and with the target, as
            far as there are any.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        bodies = [model.body(index).name for index in range(model.nbody)]
        self.hinge = np.array([model.joint(name).id for name in JOINTS])
        self.joint = model.jnt_qposadr[self.hinge]
        self.dof = model.jnt_dofadr[self.hinge]
        slides = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE.value]
        free = model.jnt_type == mujoco.mjtJoint.mjJNT_FREE.value
        place = (model.jnt_qposadr[free, None] + np.arange(7)).ravel()
        motion = (model.jnt_dofadr[free, None] + np.arange(6)).ravel()
        self.pose = np.hstack([self.joint, slides, place])
        self.motion = np.hstack([self.dof, motion])
        self.object = int(place[0]) if free.any() else -1
        self.object_body = bodies.index("object") if "object" in bodies else -1
        self.palm = bodies.index("palm")
        self.hand = np.array(
            [index for index, name in enumerate(bodies) if name == "palm" or name.endswith("_link")]
        )
        self.hand_geoms = np.flatnonzero(np.isin(model.geom_bodyid, self.hand))
        self.object_geoms = np.flatnonzero(model.geom_bodyid == self.object_body)
        standing = [index for index, name in enumerate(bodies) if name in ("support", "target")]
        self.boxes = np.flatnonzero(np.isin(model.geom_bodyid, standing))
        self.guides = np.array(
            [
                [model.site(f"{digit}_{end}_guide").id for end in ("fixed", "moving")]
                for digit in DIGITS
            ]
        )
        self.fixed = slice(0, -len(DIGITS))
        self.drives = slice(-len(DIGITS), None)
        self.wraps = slice(0, model.tendon_adr[-len(DIGITS)])
        slots = np.arange(len(PARTS) * SLOTS * FORCE_SIZE).reshape(len(PARTS), SLOTS, FORCE_SIZE)
        rest = np.arange(slots.size, model.nsensordata)
        self.touch = np.hstack([slots[..., 1].ravel(), slots[:, 0, 0], rest])[: model.nsensordata]
