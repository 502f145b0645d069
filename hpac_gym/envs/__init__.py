"""The environments. `import hpac_gym` registers them."""

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs.hand_env import GoalEnv, HandEnv
from hpac_gym.envs.randomization import Randomization
from hpac_gym.envs.registered import make_task
from hpac_gym.envs.vector_env import HandVectorEnv
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.registration import register_all
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.gentle import Gentle, GentleConfig, GentleSetup
from hpac_gym.tasks.grasp import Grasp, GraspConfig
from hpac_gym.tasks.grasp_any import GraspAny
from hpac_gym.tasks.grasp_any_setups import GraspAnyConfig, GraspAnySetup
from hpac_gym.tasks.grasp_data import GRASPS, GraspError
from hpac_gym.tasks.grasp_types import GraspByType, GraspTypeConfig, GraspTypeSetup
from hpac_gym.tasks.pick_place import PickPlace, PickPlaceConfig
from hpac_gym.tasks.posture import Posture, PostureConfig
from hpac_gym.tasks.scripted import ScriptedClosure, ScriptedPickPlace

register_all()

__all__ = [
    "GRASPS",
    "CameraNoise",
    "Gentle",
    "GentleConfig",
    "GentleSetup",
    "GoalEnv",
    "Grasp",
    "GraspAny",
    "GraspAnyConfig",
    "GraspAnySetup",
    "GraspByType",
    "GraspConfig",
    "GraspError",
    "GraspTypeConfig",
    "GraspTypeSetup",
    "HandEnv",
    "HandVectorEnv",
    "ObjectSpec",
    "PickPlace",
    "PickPlaceConfig",
    "Posture",
    "PostureConfig",
    "Randomization",
    "SceneSetup",
    "ScriptedClosure",
    "ScriptedPickPlace",
    "make_task",
]
