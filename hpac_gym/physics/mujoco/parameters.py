"""Parameters of n worlds of one layout: the fields of the model with separate values for every world,
written from their setups.
"""

import math
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from hpac_gym.body.geometry import Geometry
from hpac_gym.body.object_models import ObjectModel, principal_inertia
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.model import DIGITS, HPAC, SERVOS, Hand
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, OBJECT_COLORS, PhysicsError, SceneSetup
from hpac_gym.physics.mechanics import Mechanics, mass_matrix
from hpac_gym.physics.mujoco.model import (
    Addresses,
    Layout,
    build,
    is_straight,
    quaternion_from_matrix,
    size_of,
)
from hpac_gym.physics.settings import HandSettings, WorldSettings
from hpac_gym.physics.supports import SUPPORT_FRICTION, support_boxes

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
_ALONE = np.zeros(1, dtype=np.intp)
_ORIGIN = np.zeros(3)
_STRAIGHT = np.array([1.0, 0.0, 0.0, 0.0])


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
        self._hands: list[tuple[Geometry, Hand, HandSettings] | None] = [None] * batch.nsim
        self._links = lru_cache(maxsize=BODIES_KEPT)(self._links_of)

    def set(self, world: int, setup: SceneSetup) -> None:
        """Write the parameters of one world."""
        hand = setup.geometry, setup.hand, setup.hand_settings
        last = self._hands[world]
        self._hands[world] = None  # after an interrupt all is written again
        if last is None or last[0] != setup.geometry:
            for field, rows, values in self._links(setup.geometry):
                field[world, rows] = values
        if last != hand:
            self._set_hand(world, setup)
        self._hands[world] = hand
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
        inertia = _inertia_of_hand(setup.geometry, settings.armature)
        numbers = Mechanics.of(hand, settings, inertia, setup.geometry)
        values = {
            "site_pos": (at.guides, numbers.guides),
            "jnt_range": (at.hinge, np.stack([hand.joint_min, hand.joint_max], axis=1)),
            "dof_damping": (at.dof, settings.damping.joint),
            "dof_frictionloss": (at.dof, settings.joint_friction),
            "dof_armature": (at.dof[-1], settings.hub_inertia / hand.cmc_gain**2),
            "tendon_stiffness": (at.fixed, numbers.stiffness),
            "tendon_damping": (at.fixed, numbers.damping),
            "tendon_armature": (at.drives, numbers.hub_mass),
            "wrap_prm": (at.wraps, numbers.rows[numbers.rows != 0]),
        }
        for name, (rows, value) in values.items():
            fields[name][world, rows] = value
        gain = fields["actuator_gainprm"][world]
        bias = fields["actuator_biasprm"][world]
        gain[: len(SERVOS), 0] = numbers.gain
        bias[: len(SERVOS), :3] = numbers.bias
        fields["actuator_forcerange"][world, : len(SERVOS)] = numbers.limit
        brake = settings.damping.overrun * numbers.bias[: len(DIGITS), 2]
        gain[-len(DIGITS) :, 0] = brake * hand.servo_radius
        bias[-len(DIGITS) :, 2] = brake
        # Damping acts on the stretch rate, to which the servo's speed contributes.
        self.lead[world] = numbers.bias[:, 2] / numbers.bias[:, 1]
        fields["geom_friction"][world, at.hand_geoms, 0] = np.square(settings.contact_friction)

    def _set_object(self, world: int, setup: SceneSetup) -> None:
        fields = self.fields
        at = self._at
        spec = setup.object
        index, values = (
            _geoms_of(spec.model, spec.scale)
            if spec.model
            else (_ALONE, _geom_fields(spec.shape, *spec.half_extents))
        )
        rows = at.object_geoms
        for name, value in values.items():
            fields[name][world, rows[index]] = value
        # The hand's skin and the support multiply the object's friction; MuJoCo uses the value of
        # the geom with higher priority.
        fields["geom_friction"][world, rows, 0] = (
            setup.hand_settings.contact_friction * spec.friction
        )
        fields["geom_rgba"][world, rows] = (
            spec.model.color if spec.model else OBJECT_COLORS[spec.shape]
        )
        body = world, at.object_body
        fields["body_mass"][body] = spec.mass
        centre, fields["body_inertia"][body], turn = _inertia_of(spec)
        if self._layout.object != "primitive":
            fields["body_ipos"][body] = centre
            fields["body_iquat"][body] = turn
        if self._layout.fixed:
            fields["body_pos"][body], fields["body_quat"][body] = np.split(object_pose(setup), [3])

    def _set_supports(self, world: int, setup: SceneSetup) -> None:
        fields = self.fields
        ids = self._at.boxes
        for geom, box in zip(ids, support_boxes(setup), strict=True):
            half = box.half_extents
            x, y, z, w = box.quaternion
            fields["geom_size"][world, geom] = fields["geom_aabb"][world, geom, 3:] = half
            fields["geom_rbound"][world, geom] = math.hypot(*half)
            fields["geom_pos"][world, geom] = box.centre
            fields["geom_quat"][world, geom] = w, x, y, z
        fields["geom_friction"][world, ids, 0] = SUPPORT_FRICTION * setup.object.friction


def object_pose(setup: SceneSetup) -> Array:
    """Place of a setup's object in the world [m], then its quaternion wxyz, shape (7,)."""
    (x, y, z, w) = setup.object_turn[0]
    return np.array((*(HAND_POSITION + setup.hand_rotation @ setup.position), w, x, y, z))


@lru_cache(maxsize=64)
def _inertia_of_hand(geometry: Geometry, armature: tuple[float, float, float]) -> Array:
    """Joint-space inertia of a hand of the nominal model at half stroke, shape (15, 15) [kg·m²]."""
    return mass_matrix(geometry, armature, HPAC.synergy_max / 2)


@lru_cache(maxsize=1024)
def _geoms_of(model: ObjectModel, scale: float) -> tuple[NDArray[np.intp], dict[str, Any]]:
    """Indices of the k primitive solids among an object's, and their values of MuJoCo's geom
    fields; hulls are compiled.
    """
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
    return {
        "geom_type": getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}").value,
        "geom_size": size,
        "geom_pos": place,
        "geom_quat": turn,
        "geom_rbound": reach,
        "geom_aabb": (0.0, 0.0, 0.0, x, y, z),
    }


@lru_cache(maxsize=64)
def _inertia_of(spec: ObjectSpec) -> tuple[Array, Array, Array]:
    """Centre of mass, shape (3,) [m], principal moments about it, shape (3,) [kg·m²], and their
    axes, quaternion wxyz.
    """
    if spec.model is None:
        x, y, z = (2 * half for half in spec.half_extents)
        return _ORIGIN, np.array(principal_inertia(spec.shape, spec.mass, (x, y, z))), _STRAIGHT
    centre = spec.scale * spec.model.center_of_mass
    inertia = spec.model.inertia * (spec.mass / spec.model.mass * spec.scale**2)
    if is_straight(spec.model):
        return centre, np.diag(inertia), _STRAIGHT
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return centre, moments, quaternion_from_matrix(axes)
