"""The MuJoCo engine. In this package, only this folder imports MuJoCo."""

import os

from hpac_gym.command import stopped_later
from hpac_gym.errors import ParameterError
from hpac_gym.physics.simulation import INSTEAD

try:
    with stopped_later():  # else Ctrl-C ends it as "ImportError: initialization failed"
        import mujoco
except (AttributeError, RuntimeError) as error:  # PyOpenGL's without its library, and MuJoCo's
    raise ParameterError(
        f"MUJOCO_GL = {os.environ.get('MUJOCO_GL')!r} does not work here ({error}): unset it, or set egl and install, on "
        "Debian, libegl1 and libgl1-mesa-dri"
    ) from None

if not mujoco.__version__.startswith("4.0."):
    raise ParameterError(
        f"MuJoCo {mujoco.__version__} is installed, and engine='mujoco' needs 4.0, whose batches and integrator it was measured "
        f"with: {INSTEAD['mujoco']}"
    )
