"""Parameters of n worlds of one layout: the fields of the model with separate values for every world,
written from their setups.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hpac_gym.body.geometry import Geometry
from hpac_gym.model import DIGITS, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    OBJECT_COLORS,
    SUPPORT_FRICTION,
    PhysicsError,
    SceneSetup,
    support_boxes,
)
from hpac_gym.physics.mjcf import Mechanics, root_frames
from hpac_gym.physics.mujoco.addresses import Addresses
from hpac_gym.physics.mujoco.model import (
    Layout,
    build,
    geoms_of,
    inertia_of,
    inertia_of_hand,
)
from hpac_gym.physics.settings import HandSettings, WorldSettings

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
"""Number of hand geometries whose compiled fields are cached."""


class Parameters:
    """The parameters of n worlds.

    Args:
        layout: the parts of the scene.
        settings: settings of every world.
        visuals: include visual-only geoms.
        batch: the worlds.
        at: addresses of their model.

    Attributes:
        fields: values of the model's `FIELDS`, with a leading axis n.
        lead: time by which each drive's control leads its servo, shape (n, 6) [s].
    """

    def __init__(
        self, layout: Layout, settings: WorldSettings, visuals: bool, batch: Batch, at: Addresses
    ) -> None:
        self.fields = {name: batch.expand(name) for name in FIELDS}
        self.lead = np.zeros((batch.nsim, len(SERVOS)))
        self._layout = layout
        self._options = settings, visuals
        self._at = at
        self._model = batch.model
        self._hands: list[tuple[Hand, HandSettings, Geometry] | None] = [None] * batch.nsim
        self._links = lru_cache(maxsize=BODIES_KEPT)(self._links_of)

    def set(self, world: int, setup: SceneSetup) -> None:
        """Write the parameters of one world."""
        hand = setup.hand
        settings = setup.hand_settings
        last = self._hands[world]
        if last is None or last[2] != setup.geometry:
            for field, rows, values in self._links(setup.geometry):
                field[world, rows] = values
            last = None
        if last is None or not (last[0] is hand or last[0] == hand) or last[1] != settings:
            self._set_hand(world, setup)
        self._hands[world] = hand, settings, setup.geometry
        (x, y, z, w) = setup.hand_quaternion
        self.fields["body_quat"][world, self._at.palm] = w, x, y, z
        if setup.object is not None:
            self._set_object(world, setup)
            if not self._layout.fixed:
                self._set_supports(world, setup)

    def _links_of(self, geometry: Geometry) -> list[tuple[NDArray, NDArray, NDArray]]:
        """Fields of the links of a hand, with their rows and its values there."""
        model = build(self._layout, *self._options, geometry)
        if not np.array_equal(model.body_sameframe, self._model.body_sameframe):
            raise PhysicsError(
                "a link of this hand is wider than it is long: MuJoCo cannot have it beside others"
            )
        at = self._at
        rows = dict.fromkeys(BODY_FIELDS, at.hand) | dict.fromkeys(GEOM_FIELDS, at.hand_geoms)
        return [
            (self.fields[name], index, getattr(model, name)[index])
            for name, index in (rows | {"jnt_axis": at.hinge}).items()
        ]

    def _set_hand(self, world: int, setup: SceneSetup) -> None:
        hand = setup.hand
        settings = setup.hand_settings
        fields = self.fields
        at = self._at
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
        brakes = slice(self._model.nu - len(DIGITS), self._model.nu)
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
        at = self._at
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
        if self._layout.object != "primitive":
            fields["body_ipos"][world, body] = centre
            fields["body_iquat"][world, body] = turn
        if self._layout.fixed:
            place = HAND_POSITION + setup.hand_rotation @ setup.position
            (x, y, z, w) = setup.object_turn[0]
            fields["body_pos"][world, body] = place
            fields["body_quat"][world, body] = (w, x, y, z)

    def _set_supports(self, world: int, setup: SceneSetup) -> None:
        boxes, table, target, (x, y, z, w) = support_boxes(setup)
        fields = self.fields
        ids = self._at.boxes
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
