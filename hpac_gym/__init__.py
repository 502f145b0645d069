"""Reinforcement learning and control of the H-PAC tendon hand, from simulation to the servo.

Importing this package registers its Gymnasium environments; it loads no engine, and works without
Gymnasium. `register` adds a task of one's own."""

import sys
from contextlib import suppress

from hpac_gym.registration import register, register_all

__all__ = ["register"]

__version__ = "0.1.0"

# The `hpac` command leaves this to the commands that make environments: Gymnasium takes some tenths
# of a second to load, and a stop must not wait for it.
if "hpac" not in sys.modules:
    with suppress(ModuleNotFoundError):  # the model and the bridge work without Gymnasium
        register_all()
