"""The PyBullet engine: explicit tendon torques at 120 Hz, a direct solver, and one client per
world.
"""

from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
import pybullet
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    HAND_POSITION,
    Contacts,
    Engine,
    PhysicsError,
    SceneSetup,
    SceneState,
    Viewpoint,
)
from hpac_gym.physics.pybullet.scene import FORCE, LINK, NORMAL, POINT, Scene, matrix
from hpac_gym.physics.settings import HandSettings, WorldSettings


class PyBulletEngine(Engine):
    """`hpac_gym.physics.engine.Engine` on PyBullet. Worlds are stepped sequentially: PyBullet holds
    the GIL.

    Args:
        num_worlds: n.
        settings: settings of every world.
        visuals: load visual shapes; without them a reset is faster, the physics identical, and a
            picture shows boxes.

    Raises:
        ParameterError: Torsional friction with the direct solver.

    Attributes:
        scenes: one PyBullet world each, for tests.
    """

    def __init__(
        self, num_worlds: int = 1, settings: WorldSettings = WorldSettings(), visuals: bool = False
    ) -> None:
        if settings.torsion and not settings.solver_iterations:
            raise ParameterError(
                f"torsion = {settings.torsion} m needs Bullet's iterative solver: solver_iterations ≥ 1"
            )
        super().__init__(num_worlds, settings.dt)
        self._options = settings, visuals
        self.scenes = [Scene(*self._options) for _ in range(num_worlds)]
        self._spare: Scene | None = None

    def require(self, settings: HandSettings) -> None:
        """As `Engine.require`; inertia at the servos' hubs is not supported."""
        if settings.hub_inertia:
            raise ParameterError(
                f"hub_inertia = {settings.hub_inertia} kg m² must be 0 kg m² in PyBullet, whose explicit torques need inertia on "
                'the joints: body="light" needs engine="mujoco"'
            )

    def reset(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        for world, setup in zip(worlds, setups, strict=True):
            self._start(world, setup)
        self._forget_forces(worlds)

    def _start(self, world: int, setup: SceneSetup) -> None:
        """Start an episode. A single world keeps two hands loaded, as beside an object and above one,
        in a PyBullet world of 34 MB each; for many worlds this would take too much memory.
        """
        scene = self.scenes[world]
        if self.num_worlds == 1 and scene.setup is not None and not scene.fits(setup):
            self.scenes[0] = self._spare or Scene(*self._options)
            self._spare = scene
        self.scenes[world].reset(setup)

    def advance(
        self, servo: Array, servo_vel: Array, wrist: Array, push: Array | None = None
    ) -> None:
        # A copy: a task may return the same array again, and `restore` needs this one.
        pushes = [None] * self.num_worlds if push is None else push.copy()
        self._force_steps = np.zeros((self.num_worlds, servo.shape[1] * self.every_step))
        for scene, *tables in zip(
            self.scenes, servo, servo_vel, wrist, pushes, self._force_steps, strict=True
        ):
            scene.advance(*tables)

    def state(self) -> SceneState:
        """As `Engine.state`.

        Raises:
            PhysicsError: A world's joint angles are not finite.
        """
        found = SceneState.empty(self.num_worlds)
        found.force_steps = self._force_steps
        for world, scene in enumerate(self.scenes):
            if scene.setup is not None:
                self._read(found, world, scene)
        return found

    def _read(self, found: SceneState, world: int, scene: Scene) -> None:
        joint_pos, joint_vel, offset = scene.hand.state()
        if not isfinite(sum(joint_pos)):
            raise PhysicsError(
                f"world {world} of {self.num_worlds}: joint angles {joint_pos} rad are not finite"
            )
        found.time[world] = scene.time
        found.joint_pos[world] = joint_pos
        found.joint_vel[world] = joint_vel
        found.tension[world] = np.maximum(scene.hand.tension, 0.0)  # a brake's is negative
        found.palm_offset[world] = offset
        if scene.object is None:
            return
        position, quaternion = scene.object.pose()
        linear, angular = scene.object.velocity()
        to_hand = scene.to_hand
        found.object_pos[world] = to_hand.dot(position - HAND_POSITION - offset)
        found.object_rotation[world] = to_hand.dot(matrix(quaternion))
        found.object_vel[world] = to_hand.dot(linear)
        found.object_spin[world] = to_hand.dot(angular)
        contacts, others = scene.contacts()
        for contact in contacts:
            part = scene.hand.part_of_link[contact[LINK]]
            found.touching[world, part] = True
            found.contact_force[world, part] += contact[FORCE]
        found.supported[world] = bool(others)
        found.on_target[world] = scene.target_post in others

    def contacts(self, world: int) -> Contacts:
        scene = self.scenes[world]
        setup = scene.setup
        found, _ = scene.contacts()
        names = {index: name for name, index in scene.hand.link_index.items()} | {-1: "palm"}
        return Contacts(
            np.array([contact[POINT] for contact in found]).reshape(-1, 3),
            np.array([contact[NORMAL] for contact in found]).reshape(-1, 3),
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
        projection = pybullet.computeProjectionMatrixFOV(
            viewpoint.field_of_view_deg, viewpoint.width / viewpoint.height, 0.02, 3.0
        )
        pixels = pybullet.getCameraImage(
            viewpoint.width,
            viewpoint.height,
            view,
            projection,
            lightDirection=[0.5, 0.8, 1.0],
            shadow=1,
            renderer=pybullet.ER_TINY_RENDERER,
            physicsClientId=self.scenes[world].world.client,
        )[2]
        return np.reshape(
            np.asarray(pixels, dtype=np.uint8), (viewpoint.height, viewpoint.width, 4)
        )[:, :, :3]

    def save(self, world: int) -> Any:
        """As `Engine.save`: the episode's setup and tables. PyBullet's own snapshots omit part of
        the contact state.
        """
        return self.scenes[world].setup, list(self.scenes[world].past)

    def restore(self, world: int, snapshot: Any) -> None:
        """As `Engine.restore`: replays the episode from its start."""
        setup, past = snapshot
        self._start(world, setup)
        for tables in past:
            self.scenes[world].advance(*tables)

    def close(self) -> None:
        for scene in filter(None, (*self.scenes, self._spare)):
            scene.world.close()
