"""The paper as data and pure functions: joints, parameters, transmission, elasticity, command.

Depends on NumPy alone. Arrays have shape (..., n); angles are in rad; every function takes an
optional `hand`."""

from hpac_gym.model.calibration import Calibration, Friction
from hpac_gym.model.checks import Array
from hpac_gym.model.command import (
    ServoCommand,
    action_from_synergy,
    clip_synergy,
    clip_to_workspace,
    move_duration,
    servo_from_action,
    servo_from_joints,
    stream_command,
    streamed_servo,
    synergy_from_action,
    synergy_from_joints,
)
from hpac_gym.model.files import HPAC, hand_to_toml, load_hand
from hpac_gym.model.joints import (
    DIGITS,
    FINGERS,
    JOINT_INDEX,
    JOINTS,
    SERVO_INDEX,
    SERVOS,
    digit_joints,
)
from hpac_gym.model.parameters import Digit, Hand
from hpac_gym.model.postures import POSTURES, Posture, Reach, posture, reach
from hpac_gym.model.transmission import (
    elastic_deviation,
    elastic_joints_from_servo,
    joints_from_synergy,
    rigid_joints_from_servo,
    servo_from_synergy,
    spring_tension,
    synergy_from_servo,
    transmission_matrix,
)
from hpac_gym.model.variation import scaled_hand

__all__ = [
    "DIGITS",
    "FINGERS",
    "HPAC",
    "JOINTS",
    "JOINT_INDEX",
    "POSTURES",
    "SERVOS",
    "SERVO_INDEX",
    "Array",
    "Calibration",
    "Digit",
    "Friction",
    "Hand",
    "Posture",
    "Reach",
    "ServoCommand",
    "action_from_synergy",
    "clip_synergy",
    "clip_to_workspace",
    "digit_joints",
    "elastic_deviation",
    "elastic_joints_from_servo",
    "hand_to_toml",
    "joints_from_synergy",
    "load_hand",
    "move_duration",
    "posture",
    "reach",
    "rigid_joints_from_servo",
    "scaled_hand",
    "servo_from_action",
    "servo_from_joints",
    "servo_from_synergy",
    "spring_tension",
    "stream_command",
    "streamed_servo",
    "synergy_from_action",
    "synergy_from_joints",
    "synergy_from_servo",
    "transmission_matrix",
]
