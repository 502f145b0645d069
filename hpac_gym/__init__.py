"""Reinforcement learning and control of the H-PAC tendon hand, from simulation to the servo.

Importing this package registers its Gymnasium environments; it loads no engine, and works without
Gymnasium."""

import sys

__version__ = "0.1.0"

# The `hpac` command leaves this to the commands that make environments: Gymnasium takes some tenths
# of a second to load, and a stop must not wait for it.
if "hpac" not in sys.modules:
    try:
        from hpac_gym.registration import register_all
    except ModuleNotFoundError:  # the model and the bridge work without Gymnasium
        pass
    else:
        register_all()
