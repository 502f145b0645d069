"""Worlds of one layout: a `mujoco.batch.Batch` that is started, stepped and read."""

from collections.abc import Sequence
from functools import cached_property

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError
from numpy.typing import NDArray

from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.model import DIGITS, JOINTS, SERVOS, joints_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import HAND_POSITION, PARTS, SceneSetup, SceneState
from hpac_gym.physics.mujoco.model import SLOTS, Addresses, Layout, build
from hpac_gym.physics.mujoco.parameters import Parameters, object_pose
from hpac_gym.physics.settings import WorldSettings

Rows = NDArray[np.intp] | slice
"""Worlds of one layout: their indices, or a full slice if all have it."""
TENSION = slice(0, len(DIGITS))
FORCE = slice(TENSION.stop, TENSION.stop + len(PARTS) * SLOTS)
NUMBER = slice(FORCE.stop, FORCE.stop + len(PARTS) + 2)
"""Columns of what is felt in a physics step: tensions of the drives [N]; normal forces in the slots of
`PARTS` [N]; numbers of contacts of the object with `PARTS`, with its support and with the target."""
CONTROLS = mujoco.mjtState.mjSTATE_CTRL.value


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
        self.parameters = Parameters(layout, settings, visuals, self.batch, self.at)
        self.qpos = self.batch.bind("qpos")
        self.qvel = self.batch.bind("qvel")
        self._blank = self.batch.state[0].copy()
        self._actuators = self.batch.bind("actuator_force")
        self._sensors = (
            self.batch.bind("sensordata") if model.nsensor else np.zeros((num_worlds, 0))
        )
        self.felt = np.zeros((num_worlds, NUMBER.stop))
        self._touched = slice(FORCE.start, FORCE.start + len(self.at.touch))
        self._to_hand = np.zeros((num_worlds, 3, 3))

    @cached_property
    def single(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Model and data for one of the worlds at a time: making them takes longer than filling them."""
        return self.batch.get_model(0), self.batch.get_data(0)

    def start(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        """Reset worlds, given in ascending order, to the start of their setups."""
        self.batch.state[worlds] = self._blank
        self.batch.warning[worlds] = 0
        self.felt[worlds] = 0.0
        at = self.at
        for world, setup in zip(worlds, setups, strict=True):
            self.parameters.set(world, setup)
            self._to_hand[world] = setup.hand_rotation.T
            self.qpos[world, at.joint] = joints_from_synergy(setup.synergy, setup.hand)
            if at.object >= 0:
                self.qpos[world, at.object : at.object + 7] = object_pose(setup)
        self.batch.set_const(worlds)

    def advance(
        self,
        rows: Rows,
        servo: Array,
        servo_vel: Array,
        wrist: Array,
        push: Array | None,
        force_steps: Array,
    ) -> dict[int, str]:
        """Step worlds through the tables of `Engine.advance`, each with a row for every world.

        Args:
            rows: the worlds.
            force_steps: receives `SceneState.force_steps` of these worlds; has no columns if they are
                not wanted.

        Returns:
            The worlds that failed, each with the reason.
        """
        model = self.batch.model
        servo_vel = servo_vel[rows]
        n, steps, _ = servo_vel.shape
        control = np.empty((n, steps, model.nu))
        control[..., : len(SERVOS)] = servo[rows] + self.parameters.lead[rows, None] * servo_vel
        slides = control[..., len(SERVOS) : -len(DIGITS)]
        slides[:] = wrist[rows, :, : slides.shape[-1]]
        control[..., -len(DIGITS) :] = np.maximum(servo_vel[..., : len(DIGITS)], 0.0)
        columns = CONTROLS
        pushed = push is not None and self.at.object >= 0
        if pushed:
            columns |= mujoco.mjtState.mjSTATE_XFRC_APPLIED.value
            forces = np.zeros((n, steps, model.nbody, 6))
            forces[:, :, self.at.object_body, :3] = push[rows]
            control = np.concatenate([control, forces.reshape(n, steps, -1)], axis=2)
        recorded = {}
        if force_steps.size and self._sensors.size:
            recorded["sensordata"] = np.zeros((n, steps, self._sensors.shape[1]))
        failed: dict[int, str] = {}
        handler = mujoco.get_mju_user_warning()
        # Without a handler MuJoCo writes a log file to the working directory.
        mujoco.set_mju_user_warning(lambda text: None)
        try:
            ids = None if isinstance(rows, slice) else rows
            self.batch.rollout(steps, control, columns, tuple(recorded), ids, recorded)
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
        self.felt[rows, TENSION] = -self._actuators[rows, TENSION]
        self.felt[rows, self._touched] = self._sensors[rows].take(self.at.touch, axis=1)
        if recorded:
            forces = self.at.touch[: FORCE.stop - FORCE.start]
            force_steps[rows] = recorded["sensordata"].take(forces, axis=2).sum(axis=2)
        return failed

    def state(self, rows: Rows, time: Array, force_steps: Array) -> SceneState:
        """State of worlds at their times, shape (m,) [s], with the forces in their last physics steps,
        shape (m, k) [N].
        """
        pose = self.qpos[rows].take(self.at.pose, axis=1)
        motion = self.qvel[rows].take(self.at.motion, axis=1)
        offset, place, rotation, velocity, spin = self._object(
            rows, pose[:, len(JOINTS) :], motion[:, len(JOINTS) :]
        )
        felt = self.felt[rows]
        touching = felt[:, NUMBER] > 0
        on_target = touching[:, -1]
        return SceneState(
            time=time,
            joint_pos=pose[:, : len(JOINTS)],
            joint_vel=motion[:, : len(JOINTS)],
            horn=np.zeros((len(pose), len(SERVOS))),
            tension=felt[:, TENSION].copy(),
            palm_offset=offset,
            object_pos=place,
            object_rotation=rotation,
            object_vel=velocity,
            object_spin=spin,
            touching=touching[:, : len(PARTS)],
            contact_force=np.add.reduce(felt[:, FORCE].reshape(-1, len(PARTS), SLOTS), axis=2),
            supported=touching[:, len(PARTS)] | on_target,
            on_target=on_target,
            force_steps=force_steps,
        )

    def _object(self, rows: Rows, pose: Array, motion: Array) -> tuple[Array, ...]:
        """Offset of the palm; place, rotation, velocity and spin of the object; from what follows the
        joints in `Addresses.pose` and `Addresses.motion`.
        """
        n = len(pose)
        if self.layout.object is None:
            return tuple(np.zeros((n, *shape)) for shape in ((3,), (3,), (3, 3), (3,), (3,)))
        offset = pose[:, :3]
        if self.layout.fixed:
            fields = self.parameters.fields
            place = fields["body_pos"][rows, self.at.object_body]
            turn = fields["body_quat"][rows, self.at.object_body]
        else:
            place = pose[:, 3:6]
            turn = pose[:, 6:]
        to_hand = self._to_hand[rows]
        rotation = to_hand @ _matrices(turn)
        place = _turned(to_hand, place - HAND_POSITION - offset)
        if self.layout.fixed:
            return offset, place, rotation, np.zeros((n, 3)), np.zeros((n, 3))
        velocity = _turned(to_hand, motion[:, :3])
        # MuJoCo expresses a free body's angular velocity in the body's own axes.
        return offset, place, rotation, velocity, _turned(rotation, motion[:, 3:])


def _turned(rotation: Array, vector: Array) -> Array:
    """Vectors, shape (n, 3), rotated by matrices, shape (n, 3, 3)."""
    return (rotation @ vector[..., None])[..., 0]


def _matrices(quaternion: Array) -> Array:
    """Rotation matrices of unit quaternions wxyz, shapes (n, 4) and (n, 3, 3)."""
    products = quaternion.take(_LEFT, axis=1) * quaternion.take(_RIGHT, axis=1)
    products *= _FACTOR
    rotation = products[:, :9] + products[:, 9:]
    rotation += _DIAGONAL
    return rotation.reshape(-1, 3, 3)


_LEFT, _RIGHT = (
    np.array(["wxyz".index(axis) for axis in axes])
    for axes in ("yxxxxyxyxzzyzzxyxy", "yyzyxzzzxzwwwzwwwy")
)
"""Factors of the products yy, xy, xz, xy, xx, yz, xz, yz and xx, and of those that are added to them:
zz, zw, yw, zw, zz, xw, yw, xw and yy.
"""
_DIAGONAL = np.array([1.0, *[-0.0] * 3] * 2 + [1.0])  # adding −0 changes nothing, not even a −0
_FACTOR = 2.0 * np.array([-1, 1, 1, 1, -1, 1, 1, 1, -1, -1, -1, 1, 1, -1, -1, -1, 1, -1])
