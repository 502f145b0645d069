"""The H-PAC hand in LeRobot: ``--robot.type=hpac``, and teleoperators ``hpac_policy``,
``hpac_sliders``, ``hpac_keyboard``, ``hpac_landmarks``.

LeRobot imports this package by its name and finds the classes by the names of their settings."""

from lerobot_robot_hpac.features import EnvironmentStateStep
from lerobot_robot_hpac.robot import Hpac, HpacConfig
from lerobot_robot_hpac.teleoperators import (
    HpacKeyboard,
    HpacKeyboardConfig,
    HpacLandmarks,
    HpacLandmarksConfig,
    HpacPolicy,
    HpacPolicyConfig,
    HpacSliders,
    HpacSlidersConfig,
)

__all__ = [
    "EnvironmentStateStep",
    "Hpac",
    "HpacConfig",
    "HpacKeyboard",
    "HpacKeyboardConfig",
    "HpacLandmarks",
    "HpacLandmarksConfig",
    "HpacPolicy",
    "HpacPolicyConfig",
    "HpacSliders",
    "HpacSlidersConfig",
]
