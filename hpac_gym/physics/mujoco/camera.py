"""Offscreen rendering: OpenGL through EGL on Linux, where a software driver suffices."""

import os
import sys
import weakref
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from hpac_gym.model.checks import Array
from hpac_gym.physics.engine import PhysicsError, Viewpoint

MAX_SHAPES = 500
"""Capacity of one rendered scene; the scene with the most solids and walls uses a third of it."""


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
