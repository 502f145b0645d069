"""Options of the environments: the table that the documentation prints, and their validation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass
from os import PathLike
from typing import Any

import numpy as np

from hpac_gym.body.object_sets import SPLITS
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs.randomization import PRESETS, Randomization, randomization
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINTS, Hand, load_hand
from hpac_gym.model.checks import as_bounded_array, as_finite_vector
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.settings import BODIES, WorldSettings
from hpac_gym.physics.simulation import ENGINES, default_engine
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.config import settings_from
from hpac_gym.tasks.grasp_any import HANDS, WRISTS
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL
from hpac_gym.tasks.grasp_types import GRASP_TYPES, OBJECTS, TYPE_SPLITS
from hpac_gym.tasks.grasp_types import WRISTS as TYPE_WRISTS
from hpac_gym.tasks.task import Task

MODELS = EXACT, CALIBRATED = "hand", "calibrated"
RENDER_MODES = ["human", "rgb_array"]
GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE = IDS = (
    "HPAC-Grasp-v0",
    "HPAC-GraspAny-v1",
    "HPAC-GraspType-v0",
    "HPAC-PickPlace-v0",
    "HPAC-Posture-v1",
)
_SETUP_ARRAYS = {
    "position": 3,
    "synergy": 6,
    "hand_quaternion": 4,
    "object_quaternion": 4,
    "target": 3,
}


@dataclass(frozen=True, slots=True)
class Option:
    """An argument of an environment's id."""

    name: str
    values: tuple[str | None, ...]
    """Values that can be given by name."""
    default: Any
    meaning: str
    others: str = ""
    """Other accepted values, in words."""
    ids: tuple[str, ...] = IDS
    """Ids that accept the option."""


OPTIONS = (
    Option(
        "grasp",
        (None, *GRASPS),
        None,
        "a named grasp with its object; None draws a primitive in front of the open hand",
        ids=(GRASP,),
    ),
    Option(
        "variant",
        (NOMINAL, "large", "small", "heavy", "slippery", "shape"),
        NOMINAL,
        "variant of a named grasp's object",
        ids=(GRASP,),
    ),
    Option(
        "objects",
        SPLITS,
        "train",
        "split from which objects are drawn; the other two must not be used in training",
        ids=(GRASP_ANY,),
    ),
    Option(
        "hands",
        HANDS,
        "nominal",
        "*nominal* is `hand`; *train* draws one of 32 hands of other lengths, tendons and servos "
        "for every episode, *test* one of 8 others; no policy is told which, and nothing may be trained on the latter",
        ids=(GRASP_ANY,),
    ),
    Option(
        "wrist",
        WRISTS,
        "script",
        "*script* leaves the wrist where the sampler put it; *free* lets the first action of an "
        "episode move it, by four numbers more",
        ids=(GRASP_ANY,),
    ),
    Option(
        "types",
        (*TYPE_SPLITS, *GRASP_TYPES),
        "all",
        "the types that an episode may ask for: all sixteen, those to train on, "
        "those held out, one, or several",
        others="list of names",
        ids=(GRASP_TYPE,),
    ),
    Option(
        "objects",
        OBJECTS,
        "train",
        "*train* has the types' own objects, *test* draws one of their held-out variants, on "
        "which nothing may be trained",
        ids=(GRASP_TYPE,),
    ),
    Option(
        "wrist",
        TYPE_WRISTS,
        "free",
        "*free* lets the first action of an episode say where the wrist goes, by six numbers "
        "more; *script* puts it where the type wants it",
        ids=(GRASP_TYPE,),
    ),
    Option(
        "object",
        (None,),
        None,
        "object that replaces the primitive, such as one that `own_object` loads from a file; a "
        "dictionary has the arguments of `own_object`",
        others="`hpac_gym.body.objects.ObjectSpec`, dictionary",
        ids=(GRASP,),
    ),
    Option(
        "hand",
        (),
        HPAC,
        "the hand that is simulated, with the servo zeros of its file; `HPAC` is the hand of the paper, "
        "`hpac_gym.model.HPAC`",
        others="`hpac_gym.model.Hand`, path of a hand file",
    ),
    Option(
        "model",
        MODELS,
        HPAC,
        "the hand with which commands and observations are computed: a hand file is what `hpac calibrate` "
        "writes, and its commands invert it; *hand* knows the numbers of the simulated hand exactly; "
        '*calibrated*, for `hands="test"`, has for each held-out hand the file of its own simulated sweep',
        others="`hpac_gym.model.Hand`, path of a hand file",
    ),
    Option(
        "obs",
        ("deploy", "privileged", "image"),
        "deploy",
        "observation: that of the real hand; with terms known only in "
        "simulation, for a critic; or with an image",
        ids=(GRASP, GRASP_TYPE, PICK_PLACE, POSTURE),
    ),
    Option(
        "obs",
        ("deploy", "load", "points", "privileged", "image"),
        "deploy",
        "observation: that of a hand and a "
        "camera; with the servos' feedback, with visible points of the object's surface, with terms known only in simulation, "
        "or with an image",
        ids=(GRASP_ANY,),
    ),
    Option(
        "reward", ("dense", "sparse"), "dense", "sum of the task's reward terms, or success only"
    ),
    *(
        Option(
            "randomize",
            (None, *PRESETS),
            default,
            "domain randomization of episodes: a preset, or ranges by name; None is "
            '"nominal", which changes nothing',
            others="`hpac_gym.envs.Randomization`, dictionary of ranges",
            ids=ids,
        )
        for default, ids in (
            ("hand", (POSTURE,)),
            (None, (GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE)),
        )
    ),
    Option(
        "noise",
        (None,),
        None,
        "standard deviations of the object camera's noise: `position`, of each coordinate "
        "[m]; `angle`, of the rotation about each axis [rad]; `size`, relative. None is "
        + ", ".join(f"{value:g}" for value in astuple(CameraNoise())),
        others="`hpac_gym.envs.CameraNoise`, dictionary of its fields",
        ids=(GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE),
    ),
    *(
        Option(
            "config",
            (None,),
            None,
            "sampling ranges, success criteria and reward weights; None is as on this page",
            others=f"`hpac_gym.envs.{kind}`, dictionary of its fields",
            ids=(env_id,),
        )
        for env_id, kind in (
            (GRASP, "GraspConfig"),
            (GRASP_ANY, "GraspAnyConfig"),
            (GRASP_TYPE, "GraspTypeConfig"),
            (PICK_PLACE, "PickPlaceConfig"),
            (POSTURE, "PostureConfig"),
        )
    ),
    Option(
        "engine",
        (None, *ENGINES),
        None,
        "the physics engine; None is PyBullet where it is installed, and MuJoCo elsewhere",
    ),
    Option(
        "body",
        tuple(BODIES),
        "twin",
        "the hand's inertia: *twin* has an armature on every joint, which PyBullet's explicit "
        "torques need; *light* has the links' own inertia and the servos' at their hubs, and needs MuJoCo",
    ),
    Option(
        "render_mode",
        (None, *RENDER_MODES),
        None,
        "*rgb_array*: `render()` returns images; *human*: every step "
        "is shown on a page in the browser, in real time",
    ),
)
"""Every argument of the ids, except those of `gymnasium.make` itself."""


@dataclass(frozen=True, slots=True)
class Options:
    """Validated options of an environment; see `OPTIONS`."""

    hand: Hand
    model: Hand | str
    """A model, or one of `MODELS`: a model for every episode's hand."""
    obs: str
    reward: str
    randomization: Randomization
    noise: CameraNoise
    engine: str
    body: str
    visuals: bool
    world: WorldSettings = WorldSettings()
    """Integration; no environment offers it, since its results would not be those of its id."""


def checked_options(
    hand: Hand | str | PathLike[str] = HPAC,
    model: Hand | str | PathLike[str] = HPAC,
    obs: str = "deploy",
    reward: str = "dense",
    randomize: Randomization | Mapping | str | None = None,
    noise: CameraNoise | Mapping | None = None,
    engine: str | None = None,
    body: str = "twin",
    render_mode: str | None = None,
) -> Options:
    """Validate the options of an environment; see `OPTIONS`.

    Raises:
        ParameterError: Unknown value, or a bad hand file.
    """
    given = {
        "obs": obs,
        "reward": reward,
        "engine": engine,
        "body": body,
        "render_mode": render_mode,
    }
    for name, value in given.items():
        known = list(
            dict.fromkeys(
                known for option in OPTIONS if option.name == name for known in option.values
            )
        )
        if not (isinstance(value, str | None) and value in known):
            raise ParameterError(f"{name} {value!r} is not one of {', '.join(map(str, known))}")
    for name, value in (("hand", hand), ("model", model)):
        if not isinstance(value, Hand | str | PathLike):
            raise ParameterError(f"{name} {value!r} is neither a Hand nor the path of a hand file")
    noise = settings_from(CameraNoise(), noise, "noise")
    return Options(
        hand if isinstance(hand, Hand) else load_hand(hand),
        model if isinstance(model, Hand) or model in MODELS else load_hand(model),
        obs,
        reward,
        randomization(randomize),
        noise,
        engine or default_engine(),
        body,
        render_mode is not None,
    )


def check_num_envs(num_envs: int) -> None:
    """Refuse a number of environments that is not a positive whole number.

    Raises:
        ParameterError: It is not.
    """
    if not (isinstance(num_envs, int | np.integer) and num_envs >= 1):
        raise ParameterError(f"num_envs = {num_envs} must be a whole number of at least 1")


def setup_of(options: Mapping[str, Any] | None, task: Task, hand: Hand) -> SceneSetup | None:
    """Setup given by the options of a `reset`, or None.

    Raises:
        ParameterError: Unknown option, or an invalid setup.
        ShapeError: An array of the setup, its yaw, or a goal has the wrong shape, NaN or infinity.
        WorkspaceError: A goal that leaves the bounds of the observation.
    """
    name = "goal" if task.goal_terms else "setup"
    if not isinstance(options, Mapping | None) or set(options or {}) - {name}:
        raise ParameterError(f"options {options!r} of reset must be None or {{{name!r}: ...}}")
    given = (options or {}).get(name)
    if given is None:
        return None
    if task.goal_terms:
        term = task.goal_terms[0]
        size = len(JOINTS)
        low = np.full(size, term.low)
        high = np.full(size, term.high)
        goal = as_bounded_array(
            as_finite_vector(given, size, "goal"), low, high, JOINTS, "goal", "rad"
        )
        return SceneSetup(None, hand=hand, goal=goal)
    if not (isinstance(given, SceneSetup) and isinstance(given.object, ObjectSpec)):
        raise ParameterError(
            f"option 'setup' must be a SceneSetup with an ObjectSpec, not {given!r}"
        )
    for name, size in _SETUP_ARRAYS.items():
        if getattr(given, name) is not None:
            as_finite_vector(getattr(given, name), size, f"setup {name}")
    as_finite_vector([given.yaw], 1, "setup yaw")
    return given
