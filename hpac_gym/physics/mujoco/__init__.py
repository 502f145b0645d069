"""The MuJoCo engine. In this package, only this folder imports MuJoCo."""

from hpac_gym.command import stopped_later
from hpac_gym.errors import ParameterError
from hpac_gym.physics.simulation import INSTEAD

with stopped_later():  # else Ctrl-C ends it as "ImportError: initialization failed"
    import mujoco

if not mujoco.__version__.startswith("4.0."):
    raise ParameterError(
        f"MuJoCo {mujoco.__version__} is installed, and engine='mujoco' needs 4.0, whose batches and integrator it was measured "
        f"with: {INSTEAD['mujoco']}"
    )
