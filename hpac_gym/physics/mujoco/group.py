"""Worlds of one layout: a `mujoco.batch.Batch`, and the conversion of a setup to a world's
parameters and state.
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY, Geometry
from hpac_gym.model import DIGITS, JOINTS, SERVOS, Hand, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    OBJECT_COLORS,
    PARTS,
    SUPPORT_FRICTION,
    PhysicsError,
    SceneSetup,
    support_boxes,
)
from hpac_gym.physics.mjcf import Mechanics, fixed_tendons, root_frames
from hpac_gym.physics.mujoco.model import (
    FORCE_SIZE,
    SLOTS,
    Layout,
    build,
    geoms_of,
    inertia_of,
    inertia_of_hand,
)
from hpac_gym.physics.settings import HandSettings, WorldSettings

Index = NDArray[np.intp]
Rows = Index | slice
"""Worlds of one layout: their indices, or a full slice if all have it."""

BODY_FIELDS = ("body_pos", "body_quat", "body_mass", "body_inertia", "body_ipos", "body_iquat")
GEOM_FIELDS = ("geom_size", "geom_pos", "geom_quat", "geom_rbound", "geom_aabb")
FIELDS = (
    *BODY_FIELDS,
    *GEOM_FIELDS,
    *("geom_type", "geom_friction", "geom_rgba"),
    *("site_pos", "jnt_axis", "jnt_range", "dof_damping", "dof_frictionloss", "dof_armature"),
    *("tendon_stiffness", "tendon_damping", "tendon_armature", "wrap_prm"),
    *("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"),
)
"""Fields of the model with separate values for every world."""
BODIES_KEPT = 64
"""Number of hand geometries whose compiled fields a group caches."""
TENSION = slice(0, len(DIGITS))
TOUCHING = slice(len(DIGITS), len(DIGITS) + len(PARTS))
FORCE = slice(TOUCHING.stop, TOUCHING.stop + len(PARTS))
ON_SUPPORT = FORCE.stop
ON_TARGET = FORCE.stop + 1
FELT = FORCE.stop + 2
"""Columns of `Group.felt`, and their number: tensions of the drives [N], numbers of contacts of
`PARTS`, their normal forces [N], numbers of contacts of the object with its support and with the
target."""


class Addresses:
    """Indices into the arrays of a compiled model that `build` made.

    Attributes:
        joint: positions of `JOINTS` in qpos.
        dof: positions of `JOINTS` in qvel.
        hinge: indices of `JOINTS` among the model's joints.
        wrist: positions of the three slides in qpos and qvel; empty for a hand alone.
        object: position of the object in qpos; −1 without a movable object.
        object_dof: position of the object in qvel; −1 without a movable object.
        object_body: index of the object's body; −1 without an object.
        palm: index of the palm's body.
        hand_geoms: geoms of the hand.
        object_geoms: geoms of the object.
        boxes: geoms of posts and walls, then the table, then the target's post.
        guides: sites of the drives' guides, fixed and moving, by digit, shape (5, 2).
        fixed: couplings, then springs.
        drives: spatial tendons, by digit.
        wraps: positions of the fixed tendons' coefficients in wrap_prm.
        body_fields: rows of the hand in the fields that its `Geometry` determines.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        def geoms(prefix: str) -> list[int]:
            return [
                index for index in range(model.ngeom) if model.geom(index).name.startswith(prefix)
            ]

        bodies = [model.body(index).name for index in range(model.nbody)]
        joints = [model.joint(index).name for index in range(model.njnt)]
        hand = np.array(
            [index for index, name in enumerate(bodies) if name == "palm" or name.endswith("_link")]
        )
        movable = "object" in joints
        self.hinge = np.array([joints.index(name) for name in JOINTS])
        self.joint = model.jnt_qposadr[self.hinge]
        self.dof = model.jnt_dofadr[self.hinge]
        self.wrist = np.array(
            [index for index, name in enumerate(joints) if name.startswith("wrist")], dtype=int
        )
        self.object = int(model.joint("object").qposadr[0]) if movable else -1
        self.object_dof = int(model.joint("object").dofadr[0]) if movable else -1
        self.object_body = bodies.index("object") if "object" in bodies else -1
        self.palm = bodies.index("palm")
        self.hand_geoms = np.flatnonzero(np.isin(model.geom_bodyid, hand))
        self.object_geoms = np.array(geoms("object_"), dtype=int)
        self.boxes = np.array(geoms("support_") + geoms("table") + geoms("target"), dtype=int)
        self.guides = np.array(
            [
                [model.site(f"{digit}_{end}_guide").id for end in ("fixed", "moving")]
                for digit in DIGITS
            ]
        )
        self.fixed = np.array([model.tendon(name).id for name in fixed_tendons()])
        self.drives = np.array([model.tendon(f"{digit}_drive").id for digit in DIGITS])
        self.wraps = np.array(
            [model.tendon_adr[i] + k for i in self.fixed for k in range(model.tendon_num[i])]
        )
        self.body_fields = {
            **dict.fromkeys(BODY_FIELDS, hand),
            **dict.fromkeys(GEOM_FIELDS, self.hand_geoms),
        }
        self.body_fields["jnt_axis"] = self.hinge


class Group:
    """The worlds that share one layout. Row i of its batch belongs to world i, even while that
    world has another layout.

    Args:
        layout: the parts of the scene.
        num_worlds: number of worlds of the engine.
        settings: settings of every world.
        threads: number of threads.
        visuals: include visual-only geoms.
    """

    def __init__(
        self, layout: Layout, num_worlds: int, settings: WorldSettings, threads: int, visuals: bool
    ) -> None:
        self.layout = layout
        self.model = build(layout, settings, visuals, HPAC_GEOMETRY)
        self.at = Addresses(self.model)
        self.batch = Batch(self.model, num_worlds, threads)
        self.fields = {name: self.batch.expand(name) for name in FIELDS}
        self.qpos = self.batch.bind("qpos")
        self.qvel = self.batch.bind("qvel")
        self._blank = self.batch.state[0].copy()
        self.force = self.batch.bind("actuator_force")
        self.sensors = (
            self.batch.bind("sensordata") if self.model.nsensor else np.zeros((num_worlds, 0))
        )
        self.lead = np.zeros((num_worlds, len(SERVOS)))
        # Column 1 counts each warning; column 0 is its last subject.
        self.warnings = self.batch.warning[:, :, 1]
        self.warned = self.warnings.copy()
        self._hands: list[tuple[Hand, HandSettings, Geometry] | None] = [None] * num_worlds
        self._options = (settings, visuals)
        self._bodies = {}

    # Parameters ----------------------------------------------------------------

    def set(self, world: int, setup: SceneSetup) -> None:
        """Write the parameters of one world."""
        hand = setup.hand
        settings = setup.hand_settings
        last = self._hands[world]
        if last is None or last[2] != setup.geometry:
            self._set_body(world, setup.geometry)
            last = None
        if last is None or not (last[0] is hand or last[0] == hand) or last[1] != settings:
            self._set_hand(world, setup)
        self._hands[world] = hand, settings, setup.geometry
        fields = self.fields
        at = self.at
        x, y, z, w = setup.hand_quaternion
        fields["body_quat"][world, at.palm] = w, x, y, z
        if setup.object is not None:
            self._set_object(world, setup)
        if not self.layout.fixed and setup.object is not None:
            self._set_supports(world, setup)

    def _set_body(self, world: int, geometry: Geometry) -> None:
        """Set the links of a world's hand, compiled once for each geometry and layout."""
        if geometry not in self._bodies:
            if len(self._bodies) == BODIES_KEPT:
                self._bodies.pop(next(iter(self._bodies)))
            model = build(self.layout, *self._options, geometry)
            if not np.array_equal(model.body_sameframe, self.model.body_sameframe):
                raise PhysicsError(
                    "a link of this hand is wider than it is long: MuJoCo cannot have it beside others"
                )
            self._bodies[geometry] = {
                name: getattr(model, name)[rows] for name, rows in self.at.body_fields.items()
            }
        for name, values in self._bodies[geometry].items():
            self.fields[name][world, self.at.body_fields[name]] = values

    def _set_hand(self, world: int, setup: SceneSetup) -> None:
        hand = setup.hand
        settings = setup.hand_settings
        fields = self.fields
        at = self.at
        inertia = inertia_of_hand(setup.geometry, settings.armature)
        numbers = Mechanics.of(hand, settings, inertia, root_frames(setup.geometry))
        fields["site_pos"][world, at.guides] = numbers.guides
        fields["jnt_range"][world, at.hinge] = np.stack([hand.joint_min, hand.joint_max], axis=1)
        fields["dof_damping"][world, at.dof] = settings.damping.joint
        fields["dof_frictionloss"][world, at.dof] = settings.joint_friction
        fields["dof_armature"][world, at.dof[-1]] = settings.hub_inertia / hand.cmc_gain**2
        fields["tendon_stiffness"][world, at.fixed] = numbers.stiffness
        fields["tendon_damping"][world, at.fixed] = numbers.damping
        fields["tendon_armature"][world, at.drives] = numbers.hub_mass
        fields["wrap_prm"][world, at.wraps] = numbers.rows[numbers.rows != 0]
        gain, bias, limits = (
            fields[f"actuator_{name}"][world] for name in ("gainprm", "biasprm", "forcerange")
        )
        servos = slice(0, len(SERVOS))
        brakes = slice(self.model.nu - len(DIGITS), self.model.nu)
        gain[servos, 0] = numbers.gain
        bias[servos, :3] = numbers.bias
        limits[servos] = numbers.limit
        brake = settings.damping.overrun * numbers.bias[: len(DIGITS), 2]
        gain[brakes, 0] = brake * hand.servo_radius
        bias[brakes, 2] = brake
        # Damping acts on the stretch rate, to which the servo's speed contributes.
        self.lead[world] = numbers.bias[:, 2] / numbers.bias[:, 1]
        skin = settings.contact_friction
        fields["geom_friction"][world, at.hand_geoms, 0] = skin * skin

    def _set_object(self, world: int, setup: SceneSetup) -> None:
        fields = self.fields
        at = self.at
        spec = setup.object
        index, values = geoms_of(spec)
        rows = at.object_geoms[index]
        for name, value in values.items():
            fields[name][world, rows] = value
        # The hand's skin and the support multiply the object's friction; MuJoCo uses the value of
        # the geom with higher priority.
        rows = at.object_geoms
        fields["geom_friction"][world, rows, 0] = (
            setup.hand_settings.contact_friction * spec.friction
        )
        color = OBJECT_COLORS[spec.shape] if spec.model is None else spec.model.color
        fields["geom_rgba"][world, rows] = color
        body = at.object_body
        fields["body_mass"][world, body] = spec.mass
        centre, fields["body_inertia"][world, body], turn = inertia_of(spec)
        if self.layout.object != "primitive":
            fields["body_ipos"][world, body] = centre
            fields["body_iquat"][world, body] = turn
        if self.layout.fixed:
            place = HAND_POSITION + setup.hand_rotation @ setup.position
            (x, y, z, w) = setup.object_turn[0]
            fields["body_pos"][world, body] = place
            fields["body_quat"][world, body] = (w, x, y, z)

    def _set_supports(self, world: int, setup: SceneSetup) -> None:
        boxes, table, target, (x, y, z, w) = support_boxes(setup)
        fields = self.fields
        ids = self.at.boxes
        for geom, (half, centre) in zip(ids, boxes, strict=False):
            self._set_box(world, geom, half, centre)
            fields["geom_quat"][world, geom] = w, x, y, z
        fields["geom_pos"][world, ids[len(boxes)]] = table
        if target is not None:
            self._set_box(world, ids[-1], *target)
        fields["geom_friction"][world, ids, 0] = SUPPORT_FRICTION * setup.object.friction

    def _set_box(self, world: int, geom: int, half: Array, centre: Array) -> None:
        fields = self.fields
        fields["geom_size"][world, geom] = fields["geom_aabb"][world, geom, 3:] = half
        fields["geom_rbound"][world, geom] = math.hypot(*half)
        fields["geom_pos"][world, geom] = centre

    # State ---------------------------------------------------------------------

    def start(self, worlds: Index, setups: list[SceneSetup]) -> None:
        """Reset worlds, given in ascending order, to the start of their setups."""
        for world, setup in zip(worlds, setups, strict=True):
            self.set(world, setup)
        self.batch.set_const(worlds)
        self.batch.state[worlds] = self._blank
        at = self.at
        for world, setup in zip(worlds, setups, strict=True):
            self.qpos[world, at.joint] = joints_from_synergy(setup.synergy, setup.hand)
            if at.object >= 0:
                place = HAND_POSITION + setup.hand_rotation @ setup.position
                (x, y, z, w) = setup.object_turn[0]
                self.qpos[world, at.object : at.object + 7] = *place, w, x, y, z
        self.warned[worlds] = self.warnings[worlds]

    def advance(
        self,
        rows: Rows,
        servo: Array,
        servo_vel: Array,
        wrist: Array,
        push: Array | None,
        every_step: bool = False,
    ) -> dict[int, str]:
        """Step worlds through tables of servo angles and speeds, wrist offsets and pushes; with
        `every_step` their sensors are recorded, for `force_steps`.

        Returns:
            The worlds that failed, each with the reason.
        """
        failed: dict[int, str] = {}
        n, steps, _ = servo.shape
        control = np.empty((n, steps, self.model.nu))
        control[..., : len(SERVOS)] = servo + self.lead[rows, None] * servo_vel
        control[..., len(SERVOS) : -len(DIGITS)] = wrist[..., : len(self.at.wrist)]
        np.maximum(servo_vel[..., : len(DIGITS)], 0.0, out=control[..., -len(DIGITS) :])
        columns = mujoco.mjtState.mjSTATE_CTRL.value
        pushed = push is not None and self.at.object >= 0
        if pushed:
            columns |= mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
            forces = np.zeros((n, steps, self.model.nbody, 6))
            forces[:, :, self.at.object_body, :3] = push
            control = np.concatenate([control, forces.reshape(n, steps, -1)], axis=2)
        handler = mujoco.get_mju_user_warning()
        # Without a handler MuJoCo writes a log file to the working directory.
        mujoco.set_mju_user_warning(lambda text: None)
        try:
            self._recorded = self.batch.rollout(
                steps,
                control,
                columns,
                record=("sensordata",) if every_step and self.model.nsensor else (),
                ids=None if isinstance(rows, slice) else rows,
            )
        except SimulationError as error:
            failed = {int(world): self.batch.error(int(world)) for world in error.ids}
        finally:
            mujoco.set_mju_user_warning(handler)
            if pushed:
                self.batch.bind("xfrc_applied")[rows] = 0.0
        # MuJoCo silently stops a simulation about which it warns.
        new = self.warnings != self.warned
        for world, kind in np.argwhere(new) if new.any() else ():
            failed.setdefault(int(world), mujoco.mjtWarning(int(kind)).name.removeprefix("mjWARN_"))
        return failed

    def felt(self, rows: Rows) -> Array:
        """Forces and contacts of worlds in the last physics step, shape (m, FELT)."""
        tension = -self.force[rows, : len(DIGITS)]
        sensors = self.sensors[rows]
        found = np.zeros((len(tension), FELT))
        found[:, TENSION] = tension
        if self.model.nsensor:
            split = len(PARTS) * SLOTS * FORCE_SIZE
            slots = sensors[:, :split].reshape(-1, len(PARTS), SLOTS, FORCE_SIZE)
            found[:, TOUCHING] = slots[:, :, 0, 0]
            found[:, FORCE] = slots[..., 1].sum(axis=2)
            found[:, ON_SUPPORT : ON_SUPPORT + sensors.shape[1] - split] = sensors[:, split:]
        return found

    def force_steps(self) -> Array:
        """Sums of `FORCE` in each of the physics steps that were recorded, shape (m, k) [N]."""
        parts = self._recorded["sensordata"][..., : len(PARTS) * SLOTS * FORCE_SIZE]
        return parts.reshape(*parts.shape[:2], -1, FORCE_SIZE)[..., 1].sum(axis=2)
