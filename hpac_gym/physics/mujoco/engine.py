"""Physics of n worlds in MuJoCo: one batch per layout, without Python code between physics steps; and
their pictures, through EGL on Linux, where a software driver suffices.
"""

import os
import sys
import weakref
from collections.abc import Sequence
from dataclasses import fields
from importlib import import_module
from importlib.util import find_spec
from operator import itemgetter
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hpac_gym.errors import ParameterError
from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import (
    Contacts,
    Engine,
    PhysicsError,
    SceneSetup,
    SceneState,
    Viewpoint,
)
from hpac_gym.physics.mujoco.group import Group, Rows
from hpac_gym.physics.mujoco.model import Layout
from hpac_gym.physics.settings import HandSettings, WorldSettings

GROUPS_KEPT = 32
"""Number of layouts beyond which those that no world has are forgotten: every mesh has its own, and
the sets of objects have fewer than ten.
"""


MAX_SHAPES = 500
"""Capacity of one rendered scene; the scene with the most solids and walls uses a third of it."""


class MuJoCoEngine(Engine):
    """`hpac_gym.physics.engine.Engine` on MuJoCo. Threads, one per processor but no more than
    worlds, share the worlds of a layout; their number does not affect results.

    Args:
        num_worlds: n.
        settings: settings of every world.
        visuals: include visual-only geoms; without them a step is slightly faster and the physics
            identical.

    Raises:
        ParameterError: Iterations for Bullet's iterative solver.
    """

    def __init__(
        self, num_worlds: int = 1, settings: WorldSettings = WorldSettings(), visuals: bool = False
    ) -> None:
        if settings.solver_iterations:
            raise ParameterError(
                f"solver_iterations = {settings.solver_iterations} must be 0 in MuJoCo: they are Bullet's"
            )
        available = (
            len(os.sched_getaffinity(0))
            if hasattr(os, "sched_getaffinity")
            else os.cpu_count() or 1
        )
        super().__init__(num_worlds, settings.dt)
        self._options = num_worlds, settings, min(num_worlds, available), visuals
        self._camera: Camera | None = None
        self._groups: dict[Layout, Group] = {}
        self._group_of: list[Group | None] = [None] * num_worlds
        self._rows: dict[Group, Rows] = {}
        self._setups: list[SceneSetup | None] = [None] * num_worlds
        self._steps = np.zeros(num_worlds, int)

    def require(self, settings: HandSettings) -> None:
        """As `Engine.require`; load-dependent friction is not supported."""
        if settings.tendon_friction:
            raise ParameterError(
                f"tendon_friction = {settings.tendon_friction} must be 0 in MuJoCo, which knows no friction by load: "
                'use engine="pybullet"'
            )

    def reset(self, worlds: Sequence[int], setups: Sequence[SceneSetup]) -> None:
        started: dict[Group, list[int]] = {}
        for world, setup in sorted(zip(worlds, setups, strict=True), key=itemgetter(0)):
            layout = Layout.of(setup)
            if layout not in self._groups:
                self._groups[layout] = Group(layout, *self._options)
            self._group_of[world] = self._groups[layout]
            self._setups[world] = setup
            self._steps[world] = 0
            started.setdefault(self._groups[layout], []).append(world)
        for group, entries in started.items():
            group.start(entries, [self._setups[world] for world in entries])
        self._forget_forces(worlds)
        self._rows = {}
        for group in dict.fromkeys(filter(None, self._group_of)):
            rows = np.flatnonzero([owner is group for owner in self._group_of])
            self._rows[group] = slice(None) if len(rows) == self.num_worlds else rows
        if len(self._groups) > GROUPS_KEPT:
            self._groups = {group.layout: group for group in self._rows}

    def advance(
        self, servo: Array, servo_vel: Array, wrist: Array, push: Array | None = None
    ) -> None:
        """As `Engine.advance`.

        Raises:
            PhysicsError: Simulations failed; the error has their worlds, and their time goes on.
        """
        failed: dict[int, str] = {}
        self._force_steps = np.zeros((self.num_worlds, servo.shape[1] * self.every_step))
        for group, rows in self._rows.items():
            reasons = group.advance(rows, servo, servo_vel, wrist, push, self._force_steps)
            self._steps[rows] += servo.shape[1]
            if worlds := sorted(reasons):
                group.start(worlds, [self._setups[world] for world in worlds])
                self._force_steps[worlds] = 0.0
                failed |= reasons
        if failed:
            first, *others = sorted(failed)
            place = f"world {first} of {self.num_worlds}{f' and {len(others)} others' if others else ''}"
            raise PhysicsError(
                f"{place} failed after {(self._steps[first] - servo.shape[1]) * self.dt:.3f} s of its episode: "
                f"MuJoCo says {failed[first]}",
                sorted(failed),
            )

    def state(self) -> SceneState:
        time = self._steps * self.dt
        parts = [
            (rows, group.state(rows, time[rows], self._force_steps[rows]))
            for group, rows in self._rows.items()
        ]
        if len(parts) == 1 and isinstance(parts[0][0], slice):
            return parts[0][1]
        state = SceneState.empty(self.num_worlds)
        state.force_steps = np.zeros_like(self._force_steps)
        for rows, part in parts:
            for entry in fields(SceneState):
                getattr(state, entry.name)[rows] = getattr(part, entry.name)
        return state

    def contacts(self, world: int) -> Contacts:
        at = self._group_of[world].at
        model, data = self.single(world)
        contact = data.contact
        bodies = model.geom_bodyid[contact.geom]
        other = bodies.sum(axis=1) - at.object_body
        rows = np.flatnonzero((bodies == at.object_body).any(axis=1) & np.isin(other, at.hand))
        # A frame's first axis is the normal, which points from the first geom to the second.
        into = np.where(bodies[rows, 1] == at.object_body, 1.0, -1.0)
        normal = into[:, None] * contact.frame[rows, :3]
        wrench = np.zeros((len(rows), 6))
        for row, values in zip(rows, wrench, strict=True):
            mujoco.mj_contactForce(model, data, row, values)
        setup = self._setups[world]
        return Contacts(
            contact.pos[rows] + normal * contact.dist[rows, None] / 2,
            normal,
            wrench[:, 0],
            tuple(model.body(body).name for body in other[rows]),
            data.xpos[at.object_body].copy(),
            setup.hand_settings.contact_friction * setup.object.friction,
        )

    def single(self, world: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Model and data of one world, with all derived quantities computed from its state; the next
        call with a world of the same layout overwrites them.
        """
        batch = self._group_of[world].batch
        model, data = self._group_of[world].single
        batch.get_model(world, model)
        batch.get_data(world, data)
        mujoco.mj_forward(model, data)
        return model, data

    def picture(self, world: int, viewpoint: Viewpoint, target: Array) -> NDArray[np.uint8]:
        """As `Engine.picture`.

        Raises:
            PhysicsError: OpenGL is not available.
        """
        model, data = self.single(world)
        if self._camera is None:
            self._camera = Camera(model)
        return self._camera.picture(model, data, viewpoint, target)

    def save(self, world: int) -> Any:
        group = self._group_of[world]
        saved = group.batch.state[world].copy(), group.felt[world].copy()
        return self._setups[world], int(self._steps[world]), saved

    def restore(self, world: int, snapshot: Any) -> None:
        setup, steps, saved = snapshot
        if setup is not self._setups[world]:
            self.reset([world], [setup])
        self._steps[world] = steps
        group = self._group_of[world]
        (group.batch.state[world], group.felt[world]) = saved

    def close(self) -> None:
        if self._camera is not None:
            self._camera.close()
        self._camera = None
        self._groups.clear()
        self._rows.clear()
        self._group_of = [None] * self.num_worlds


class Camera:
    """One OpenGL context for all images of an engine, current only while it is used: so any thread
    may use and collect it, and what another camera frees is never this one's.

    Args:
        model: any model of the engine; they share their textures.

    Raises:
        PhysicsError: OpenGL is not available.

    Attributes:
        close: releases the context; so does garbage collection, and the program's end.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        if find_spec("triton"):  # comes with PyTorch for CUDA; it and Mesa each bring an LLVM,
            import_module("triton")  # and loaded after a picture it ends the process
        try:
            self._context = _gl_context()(640, 480)
            with self._context.as_current():
                self._renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except Exception as error:  # PyOpenGL and its drivers may raise anything
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            raise PhysicsError(
                f"no OpenGL for pictures ({reason}): install mujoco-core[rendering] and, on Debian, libegl1 and libgl1-mesa-dri"
            ) from None
        self.close = weakref.finalize(self, _free, self._context, self._renderer)

    def picture(
        self, model: mujoco.MjModel, data: mujoco.MjData, view: Viewpoint, target: Array
    ) -> NDArray[np.uint8]:
        """RGB image of a model whose kinematics are up to date, shape (height, width, 3)."""
        camera = mujoco.MjvCamera()
        camera.lookat[:] = target
        camera.distance = view.distance
        camera.azimuth = view.yaw_deg + 90.0
        camera.elevation = view.pitch_deg
        model.vis.global_.fovy = view.field_of_view_deg
        scene = mujoco.MjvScene(model, MAX_SHAPES)
        mujoco.mjv_updateScene(
            model,
            data,
            mujoco.MjvOption(),
            mujoco.MjvPerturb(),
            camera,
            mujoco.mjtCatBit.mjCAT_ALL.value,
            scene,
        )
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = (
            False  # shadows take three quarters of the rendering time without a GPU
        )
        pixels = np.empty((view.height, view.width, 3), np.uint8)
        rectangle = mujoco.MjrRect(0, 0, view.width, view.height)
        with self._context.as_current():
            mujoco.mjr_resizeOffscreen(view.width, view.height, self._renderer)
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._renderer)
            mujoco.mjr_render(rectangle, scene, self._renderer)
            mujoco.mjr_readPixels(pixels, None, rectangle, self._renderer)
        return pixels[::-1].copy()


def _free(context: Any, renderer: mujoco.MjrContext) -> None:
    with context.as_current():
        renderer.free()
    context.free()


def _gl_context() -> type:
    """Context class that MUJOCO_GL selects; without that variable EGL on Linux, where MuJoCo's
    default needs a display.
    """
    if sys.platform == "linux" and not os.environ.get("MUJOCO_GL"):
        from mujoco.egl import GLContext
    else:
        from mujoco.gl_context import GLContext
    return GLContext
