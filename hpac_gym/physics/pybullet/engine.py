"""The PyBullet engine: explicit tendon torques at 120 Hz, a direct solver, and one client per
world.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    PARTS,
    Contacts,
    Engine,
    PhysicsError,
    SceneSetup,
    SceneState,
    Viewpoint,
)
from hpac_gym.physics.pybullet.scene import FORCE, LINK, NORMAL, POINT, Scene
from hpac_gym.physics.settings import HandSettings, WorldSettings

_PART = {name: index for index, name in enumerate(PARTS)}


class PyBulletEngine(Engine):
    """`hpac_gym.physics.engine.Engine` on PyBullet. Worlds are stepped sequentially: PyBullet holds
    the GIL.

    Args:
        num_worlds: n.
        settings: settings of every world.
        visuals: load visual shapes; without them a reset is faster and the physics identical.

    Raises:
        ValueError: Fewer than one world.
        ParameterError: Torsional friction with the direct solver.

    Attributes:
        scenes: one PyBullet world each, for tests.
    """

    def __init__(
        self, num_worlds: int = 1, settings: WorldSettings = WorldSettings(), visuals: bool = False
    ) -> None:
        if num_worlds < 1:
            raise ValueError(f"{num_worlds} worlds: at least 1 is needed")
        if settings.torsion and not settings.solver_iterations:
            raise ParameterError(
                f"torsion = {settings.torsion} m needs Bullet's iterative solver: solver_iterations ≥ 1"
            )
        self.num_worlds = num_worlds
        self.dt = settings.dt
        self.every_step = False
        self._force_steps = np.zeros((num_worlds, 0))
        # Beside an object and above one: for many worlds this would take too much memory.
        stages = 2 if num_worlds == 1 else 1
        self.scenes = [Scene(settings, visuals, stages) for _ in range(num_worlds)]
        self._setups: list[SceneSetup | None] = [None] * num_worlds
        self._time = [0.0] * num_worlds
        # Tables of each world's episode so far.
        self._past: list[list[tuple[Array, ...]]] = [[] for _ in range(num_worlds)]

    def require(self, settings: HandSettings) -> None:
        """As `Engine.require`; inertia at the servos' hubs is not supported."""
        if settings.hub_inertia:
            raise ParameterError(
                f"hub_inertia = {settings.hub_inertia} kg m² must be 0 kg m² in PyBullet, whose explicit torques need inertia on "
                'the joints: body="light" needs engine="mujoco"'
            )

    def reset(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        for setup in setups:
            self.require(setup.hand_settings)
        for world, setup in zip(worlds, setups, strict=True):
            self.scenes[world].reset(setup)
            self._setups[world] = setup
            self._time[world] = 0.0
            self._past[world] = []

    def advance(
        self, servo: Array, servo_vel: Array, wrist: Array, push: Array | None = None
    ) -> None:
        pushes = [None] * self.num_worlds if push is None else push
        self._force_steps = np.zeros((self.num_worlds, servo.shape[1] * self.every_step))
        for world, (scene, past, *tables) in enumerate(
            zip(self.scenes, self._past, servo, servo_vel, wrist, pushes, strict=True)
        ):
            scene.advance(*tables, self._force_steps[world])
            past.append(tuple(tables))
        for _ in range(servo.shape[1]):
            self._time = [time + self.dt for time in self._time]

    def state(self) -> SceneState:
        """As `Engine.state`.

        Raises:
            PhysicsError: A world's joint angles are not finite.
        """
        found = SceneState.empty(self.num_worlds)
        found.time = np.array(self._time)
        found.force_steps = self._force_steps
        for world, scene in enumerate(self.scenes):
            if self._setups[world] is not None:
                self._read(found, world, scene)
        if not np.isfinite(found.joint_pos).all():
            bad = int(np.argmin(np.isfinite(found.joint_pos).all(axis=1)))
            raise PhysicsError(
                f"world {bad} of {self.num_worlds}: joint angles {found.joint_pos[bad]} rad are not finite"
            )
        return found

    def _read(self, found: SceneState, world: int, scene: Scene) -> None:
        found.joint_pos[world], found.joint_vel[world] = scene.hand.joint_state()
        found.tension[world] = scene.hand.tension
        found.palm_offset[world] = offset = scene.hand.palm_offset
        if scene.object is None:
            return
        position, quaternion = scene.object.pose()
        to_hand = scene.to_hand
        found.object_pos[world] = to_hand @ (position - HAND_POSITION - offset)
        rotation = np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3)
        found.object_rotation[world] = to_hand @ rotation
        linear, angular = pybullet.getBaseVelocity(
            scene.object.body, physicsClientId=scene.world.client
        )
        found.object_vel[world] = to_hand @ linear
        found.object_spin[world] = to_hand @ angular
        touching = found.touching[world]
        force = found.contact_force[world]
        for contact in scene.contacts():
            part = _PART[scene.hand.part_of_link[contact[LINK]]]
            touching[part] = True
            force[part] += contact[FORCE]
        found.supported[world] = any(map(scene.touches, scene.supports))
        found.on_target[world] = scene.target_post is not None and scene.touches(scene.target_post)

    def contacts(self, world: int) -> Contacts:
        scene = self.scenes[world]
        setup = self._setups[world]
        found = scene.contacts()
        names = {index: name for name, index in scene.hand.link_index.items()} | {-1: "palm"}
        return Contacts(
            np.array([contact[POINT] for contact in found]).reshape(-1, 3),
            -np.array([contact[NORMAL] for contact in found]).reshape(-1, 3),
            np.array([contact[FORCE] for contact in found]),
            tuple(names[contact[LINK]] for contact in found),
            scene.object.pose()[0],
            setup.hand_settings.contact_friction * setup.object.friction,
        )

    def picture(self, world: int, viewpoint: Viewpoint, target: Array) -> NDArray[np.uint8]:
        """As `Engine.picture`; PyBullet's software renderer needs no display."""
        view = pybullet.computeViewMatrixFromYawPitchRoll(
            list(target), viewpoint.distance, viewpoint.yaw_deg, viewpoint.pitch_deg, 0.0, 2
        )
        width = viewpoint.width
        height = viewpoint.height
        projection = pybullet.computeProjectionMatrixFOV(
            viewpoint.field_of_view_deg, width / height, 0.02, 3.0
        )
        pixels = pybullet.getCameraImage(
            width,
            height,
            view,
            projection,
            lightDirection=[0.5, 0.8, 1.0],
            shadow=1,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self.scenes[world].world.client,
        )[2]
        return np.reshape(np.asarray(pixels, dtype=np.uint8), (height, width, 4))[:, :, :3]

    def save(self, world: int) -> Any:
        """As `Engine.save`: the tables of the episode so far. PyBullet's own snapshots omit part of
        the contact state.
        """
        return self._setups[world], self._time[world], list(self._past[world])

    def restore(self, world: int, snapshot: Any) -> None:
        """As `Engine.restore`: replays the episode from its start, in about a millisecond per
        control step.
        """
        self._setups[world], time, past = snapshot
        self.scenes[world].reset(self._setups[world])
        for tables in past:
            self.scenes[world].advance(*tables)
        self._time[world] = time
        self._past[world] = list(past)

    def close(self) -> None:
        for scene in self.scenes:
            scene.close()
