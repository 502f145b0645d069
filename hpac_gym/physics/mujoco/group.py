"""Worlds of one layout: a `mujoco.batch.Batch` that is started, stepped and read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.model import DIGITS, JOINTS, SERVOS, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, PARTS, SceneSetup, SceneState
from hpac_gym.physics.mujoco.addresses import Addresses
from hpac_gym.physics.mujoco.model import FORCE_SIZE, SLOTS, Layout, build
from hpac_gym.physics.mujoco.parameters import Parameters
from hpac_gym.physics.settings import WorldSettings

Rows = NDArray[np.intp] | slice
"""Worlds of one layout: their indices, or a full slice if all have it."""
TENSION = slice(0, len(DIGITS))
FORCE = slice(TENSION.stop, TENSION.stop + len(PARTS) * SLOTS * FORCE_SIZE)
STANDS = slice(FORCE.stop, FORCE.stop + 2)
"""Columns of what is felt in a physics step: tensions of the drives [N], the contact sensors of
`PARTS`, and numbers of contacts of the object with its support and with the target."""
JOINT = slice(0, len(JOINTS))
OFFSET = slice(15, 18)
PLACE = slice(18, 21)
TURN = slice(21, 25)
VELOCITY = slice(15, 18)
SPIN = slice(18, 21)
"""Columns of what is read of `Addresses.pose` and, from `VELOCITY` on, of `Addresses.motion`; the
joints come first in both."""


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
        model = build(layout, settings, visuals, HPAC_GEOMETRY)
        self.at = Addresses(model)
        self.batch = Batch(model, num_worlds, threads)
        self._parameters = Parameters(layout, settings, visuals, self.batch, self.at)
        self.qpos = self.batch.bind("qpos")
        self.qvel = self.batch.bind("qvel")
        self._blank = self.batch.state[0].copy()
        self._actuators = self.batch.bind("actuator_force")
        self._sensors = (
            self.batch.bind("sensordata") if model.nsensor else np.zeros((num_worlds, 0))
        )
        self._felt = np.zeros((num_worlds, STANDS.stop))
        self._read = slice(FORCE.start, FORCE.start + self._sensors.shape[1])
        self._to_hand = np.zeros((num_worlds, 3, 3))

    def start(self, worlds: NDArray[np.intp], setups: Sequence[SceneSetup]) -> None:
        """Reset worlds, given in ascending order, to the start of their setups."""
        for world, setup in zip(worlds, setups, strict=True):
            self._parameters.set(world, setup)
        self.batch.set_const(worlds)
        self.batch.state[worlds] = self._blank
        self.batch.warning[worlds] = 0
        self._felt[worlds] = 0.0
        at = self.at
        for world, setup in zip(worlds, setups, strict=True):
            self.qpos[world, at.joint] = joints_from_synergy(setup.synergy, setup.hand)
            self._to_hand[world] = setup.hand_rotation.T
            if at.object >= 0:
                place = HAND_POSITION + setup.hand_rotation @ setup.position
                (x, y, z, w) = setup.object_turn[0]
                self.qpos[world, at.object : at.object + 7] = *place, w, x, y, z

    def advance(
        self,
        rows: Rows,
        servo: Array,
        servo_vel: Array,
        wrist: Array,
        push: Array | None,
        every_step: bool,
    ) -> dict[int, str]:
        """Step worlds through tables of servo angles and speeds, wrist offsets and pushes; with
        `every_step` their sensors are recorded, for `force_steps`.

        Returns:
            The worlds that failed, each with the reason.
        """
        model = self.batch.model
        n, steps, _ = servo.shape
        control = np.empty((n, steps, model.nu))
        drives = control[..., : len(SERVOS)]
        np.multiply(self._parameters.lead[rows, None], servo_vel, out=drives)
        np.add(servo, drives, out=drives)
        slides = control[..., len(SERVOS) : -len(DIGITS)]
        slides[:] = wrist[..., : slides.shape[-1]]
        np.maximum(servo_vel[..., : len(DIGITS)], 0.0, out=control[..., -len(DIGITS) :])
        columns = mujoco.mjtState.mjSTATE_CTRL.value
        pushed = push is not None and self.at.object >= 0
        if pushed:
            columns |= mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
            forces = np.zeros((n, steps, model.nbody, 6))
            forces[:, :, self.at.object_body, :3] = push
            control = np.concatenate([control, forces.reshape(n, steps, -1)], axis=2)
        recorded = self._sensors.size and every_step
        records = {"sensordata": np.zeros((n, steps, self._sensors.shape[1]))} if recorded else {}
        self._records = records
        failed: dict[int, str] = {}
        handler = mujoco.get_mju_user_warning()
        # Without a handler MuJoCo writes a log file to the working directory.
        mujoco.set_mju_user_warning(lambda text: None)
        try:
            ids = None if isinstance(rows, slice) else rows
            self.batch.rollout(steps, control, columns, tuple(records), ids, records)
        except SimulationError as error:
            failed = {int(world): self.batch.error(int(world)) for world in error.ids}
        finally:
            mujoco.set_mju_user_warning(handler)
            if pushed:
                self.batch.bind("xfrc_applied")[rows] = 0.0
        # MuJoCo silently stops a simulation about which it warns; column 1 counts each warning.
        if np.count_nonzero(self.batch.warning):
            for world, kind in np.argwhere(self.batch.warning[:, :, 1]):
                reason = mujoco.mjtWarning(int(kind)).name.removeprefix("mjWARN_")
                failed.setdefault(int(world), reason)
        self._felt[rows, TENSION] = -self._actuators[rows, TENSION]
        self._felt[rows, self._read] = self._sensors[rows]
        return failed

    def force_steps(self) -> Array | float:
        """Sums of the forces between hand and object in each of the physics steps that were recorded,
        shape (m, k) [N]; 0 without an object.
        """
        if not self._records:
            return 0.0
        parts = self._records["sensordata"][..., : FORCE.stop - FORCE.start]
        return parts.reshape(*parts.shape[:2], -1, FORCE_SIZE)[..., 1].sum(axis=2)

    def state(self, rows: Rows, time: Array, force_steps: Array) -> SceneState:
        """State of worlds at their times, shape (m,) [s], with the forces in their last physics steps,
        shape (m, k) [N].
        """
        pose = self.qpos[rows].take(self.at.pose, axis=1)
        motion = self.qvel[rows].take(self.at.motion, axis=1)
        offset, place, rotation, velocity, spin = self._object(rows, pose, motion)
        felt = self._felt[rows]
        slots = felt[:, FORCE].reshape(-1, len(PARTS), SLOTS, FORCE_SIZE)
        stands = felt[:, STANDS] > 0
        on_target = stands[:, 1]
        return SceneState(
            time=time,
            joint_pos=pose[:, JOINT],
            joint_vel=motion[:, JOINT],
            horn=np.zeros((len(pose), len(SERVOS))),
            tension=felt[:, TENSION].copy(),
            palm_offset=offset,
            object_pos=place,
            object_rotation=rotation,
            object_vel=velocity,
            object_spin=spin,
            touching=slots[:, :, 0, 0] > 0,
            contact_force=np.add.reduce(slots[..., 1], axis=2),
            supported=stands[:, 0] | on_target,
            on_target=on_target,
            force_steps=force_steps,
        )

    def _object(self, rows: Rows, pose: Array, motion: Array) -> tuple[Array, ...]:
        """Offset of the palm; place, rotation, velocity and spin of the object."""
        n = len(pose)
        if self.layout.object is None:
            return tuple(np.zeros((n, *shape)) for shape in ((3,), (3,), (3, 3), (3,), (3,)))
        offset = pose[:, OFFSET]
        if self.layout.fixed:
            fields = self._parameters.fields
            place = fields["body_pos"][rows, self.at.object_body]
            turn = fields["body_quat"][rows, self.at.object_body]
        else:
            place = pose[:, PLACE]
            turn = pose[:, TURN]
        to_hand = self._to_hand[rows]
        rotation = to_hand @ _matrices(turn)
        place = _turned(to_hand, place - HAND_POSITION - offset)
        if self.layout.fixed:
            return offset, place, rotation, np.zeros((n, 3)), np.zeros((n, 3))
        velocity = _turned(to_hand, motion[:, VELOCITY])
        # MuJoCo expresses a free body's angular velocity in the body's own axes.
        return offset, place, rotation, velocity, _turned(rotation, motion[:, SPIN])

    def save(self, world: int) -> Any:
        """A snapshot of one world, for `restore`."""
        return self.batch.state[world].copy(), self._felt[world].copy()

    def restore(self, world: int, snapshot: Any) -> None:
        """Continue from a snapshot of a world with the same parameters."""
        self.batch.state[world], self._felt[world] = snapshot


def _turned(rotation: Array, vector: Array) -> Array:
    """Vectors, shape (n, 3), rotated by matrices, shape (n, 3, 3)."""
    return (rotation @ vector[..., None])[..., 0]


def _matrices(quaternion: Array) -> Array:
    """Rotation matrices of unit quaternions wxyz, shapes (n, 4) and (n, 3, 3)."""
    products = quaternion.take(_LEFT, axis=1) * quaternion.take(_RIGHT, axis=1)
    products *= _FACTOR
    rotation = products[:, :9] + products[:, 9:]
    rotation[:, ::4] += 1
    return rotation.reshape(-1, 3, 3)


W, X, Y, Z = range(4)
_LEFT = np.array([Y, X, X, X, X, Y, X, Y, X, Z, Z, Y, Z, Z, X, Y, X, Y])
_RIGHT = np.array([Y, Y, Z, Y, X, Z, Z, Z, X, Z, W, W, W, Z, W, W, W, Y])
"""Factors of the products yy, xy, xz, xy, xx, yz, xz, yz and xx, and of those that are added to them:
zz, zw, yw, zw, zz, xw, yw, xw and yy.
"""
_FACTOR = 2.0 * np.array([-1, 1, 1, 1, -1, 1, 1, 1, -1, -1, -1, 1, 1, -1, -1, -1, 1, -1])
