"""Options that every environment has: one field each, with its meaning, default and check."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass, replace
from numbers import Real
from os import PathLike
from typing import Annotated, Any

import numpy as np

from hpac_gym.body.geometry import Geometry
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.envs.randomization import PRESETS, Randomization, randomization
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINTS, Hand, load_hand
from hpac_gym.model.checks import as_bounded_array, as_finite_vector, as_unit_vector
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.settings import BODIES, HandSettings, WorldSettings
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.physics.supports import support_boxes
from hpac_gym.settings import check_bounds, check_choice, settings_from
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.occlusion import points_in_object
from hpac_gym.tasks.task import GoalSetup, Option, Task, options_of

MODELS = EXACT, CALIBRATED = "hand", "calibrated"
RENDER_MODES = ["human", "rgb_array"]
_SETUP_ARRAYS = {
    "position": 3,
    "synergy": 6,
    "target": 3,
}
_SETUP_PARTS = {
    "object": ObjectSpec,
    "hand": Hand,
    "geometry": Geometry,
    "hand_settings": HandSettings,
    "support": Support | None,
    "fixed": bool,
}


@dataclass(frozen=True, slots=True)
class Options:
    """Options that every environment has, checked.

    Raises:
        ParameterError: Unknown value, or a bad hand file.
    """

    hand: Annotated[
        Hand,
        Option(
            "the hand that is simulated, with the servo zeros of its file; `HPAC` is the hand of the paper, "
            "`hpac_gym.model.HPAC`",
            others="`hpac_gym.model.Hand`, path of a hand file",
        ),
    ] = HPAC
    model: Annotated[
        Hand | str,
        Option(
            "the hand with which commands and observations are computed: a hand file is what `hpac calibrate` "
            "writes, and its commands invert it; *hand* knows the numbers of the simulated hand exactly; "
            '*calibrated*, for `hands="test"`, has for each held-out hand the file of its own simulated sweep',
            MODELS,
            "`hpac_gym.model.Hand`, path of a hand file",
        ),
    ] = HPAC
    obs: Annotated[
        str,
        Option(
            "observation: that of a hand and a camera; with terms known only in simulation, for a "
            "critic; or with an image",
        ),
    ] = "deploy"
    """Its values are those of the task: `Task.observations`."""
    reward: Annotated[
        str, Option("sum of the task's reward terms, or success only", ("dense", "sparse"))
    ] = "dense"
    randomize: Annotated[
        Randomization,
        Option(
            "domain randomization of episodes: a preset, or ranges by name; None is "
            '"nominal", which changes nothing',
            (None, *PRESETS),
            "`hpac_gym.envs.Randomization`, dictionary of ranges",
        ),
    ] = None
    noise: Annotated[
        CameraNoise,
        Option(
            "standard deviations of the object camera's noise: `position`, of each coordinate "
            "[m]; `angle`, of the rotation about each axis [rad]; `size`, relative. None is "
            + ", ".join(f"{value:g}" for value in astuple(CameraNoise())),
            (None,),
            "`hpac_gym.envs.CameraNoise`, dictionary of its fields",
        ),
    ] = None
    engine: Annotated[str, Option("the physics engine", tuple(ENGINES))] = "mujoco"
    body: Annotated[
        str,
        Option(
            "the hand's inertia: *twin* has an armature on every joint, which PyBullet's explicit "
            "torques need; *light* has the links' own inertia and the servos' at their hubs, and needs MuJoCo",
            tuple(BODIES),
        ),
    ] = "twin"
    render_mode: Annotated[
        str | None,
        Option(
            "*rgb_array*: `render()` returns images; *human*: every step "
            "is shown on a page in the browser, in real time",
            (None, *RENDER_MODES),
        ),
    ] = None
    world: WorldSettings = WorldSettings()
    """Integration; no environment offers it, since its results would not be those of its id."""

    def __post_init__(self) -> None:
        for option in COMMON:
            if option.values and not option.others:
                check_choice(option.name, getattr(self, option.name), option.values)
        for name in ("hand", "model"):
            given = getattr(self, name)
            if not isinstance(given, Hand | str | PathLike):
                raise ParameterError(
                    f"{name} {given!r} is neither a Hand nor the path of a hand file"
                )
            if not isinstance(given, Hand) and not (name == "model" and given in MODELS):
                object.__setattr__(self, name, load_hand(given))
        object.__setattr__(self, "randomize", randomization(self.randomize))
        object.__setattr__(self, "noise", settings_from(CameraNoise(), self.noise, "noise"))


COMMON = tuple(option for option in options_of(Options) if option.meaning)
"""The arguments of every id, except those of `gymnasium.make` itself."""


def checked_options(**given: Any) -> Options:
    """The options of an environment; see `Options`.

    Raises:
        TypeError: An unknown option.
        ParameterError: Unknown value, or a bad hand file.
    """
    check_names(given, [option.name for option in COMMON])
    return Options(**given)


def check_names(given: Iterable[str], known: Iterable[str]) -> None:
    """Refuse names of options.

    Raises:
        TypeError: Some are unknown.
    """
    if unknown := [name for name in given if name not in known]:
        raise TypeError(f"unknown options {', '.join(unknown)}: there are {', '.join(known)}")


def check_number(name: str, given: int) -> None:
    """Refuse a number of environments or steps that is not a positive whole number.

    Raises:
        ParameterError: It is not.
    """
    if isinstance(given, bool) or not (isinstance(given, int | np.integer) and given >= 1):
        raise ParameterError(f"{name} = {given!r} must be a whole number of at least 1")


def check_count(name: str, given: Sequence[Any], num_envs: int) -> None:
    """Refuse values that are not one per environment.

    Raises:
        ParameterError: Wrong number.
    """
    if len(given) != num_envs:
        raise ParameterError(f"{len(given)} {name} were given for {num_envs} environments")


def setups_of(
    options: Mapping[str, Any] | None, task: Task, hand: Hand, num_envs: int = 1
) -> list[SceneSetup] | None:
    """Setups of n environments given by the options of a `reset`, or None: one for all of them, or a
    list with one for each.

    Raises:
        ParameterError: Unknown option, wrong number of setups, or an invalid one.
        ShapeError: An array of a setup, its yaw, or a goal has the wrong shape, NaN or infinity.
        WorkspaceError: A goal that leaves the bounds of the observation.
    """
    name = "goal" if task.goal_terms else "setup"
    if not isinstance(options, Mapping | None) or set(options or {}) - {name}:
        raise ParameterError(f"options {options!r} of reset must be None or {{{name!r}: ...}}")
    given = (options or {}).get(name)
    if given is None:
        return None
    one = _setup_of_goal if task.goal_terms else _checked_setup
    # A goal may itself be a list of numbers.
    listed = isinstance(given, list | tuple) and not all(isinstance(x, Real) for x in given)
    if not listed:
        return [one(given, task, hand)] * num_envs
    check_count(f"{name}s", given, num_envs)
    return [one(entry, task, hand) for entry in given]


def _setup_of_goal(given: Any, task: Task, hand: Hand) -> GoalSetup:
    term = task.goal_terms[0]
    size = len(JOINTS)
    bounds = np.full(size, term.low), np.full(size, term.high)
    goal = as_bounded_array(as_finite_vector(given, size, "goal"), *bounds, JOINTS, "goal", "rad")
    return GoalSetup(None, hand=hand, goal=goal)


def _checked_setup(given: Any, task: Task, hand: Hand) -> SceneSetup:
    if not isinstance(given, SceneSetup):
        raise ParameterError(f"option 'setup' must be a SceneSetup, not {given!r}")
    for name, kind in _SETUP_PARTS.items():
        if not isinstance(part := getattr(given, name), kind):
            kinds = " or ".join(one.__name__ for one in getattr(kind, "__args__", (kind,)))
            raise ParameterError(f"setup {name} must be of type {kinds}, not {part!r}")
    found: dict[str, Any] = {
        name: as_finite_vector(getattr(given, name), size, f"setup {name}")
        for name, size in _SETUP_ARRAYS.items()
        if name != "target" or given.target is not None
    }
    check_bounds(given, "setup")
    for name in ("hand_quaternion", "object_quaternion"):
        found[name] = tuple(as_unit_vector(getattr(given, name), 4, f"setup {name}").tolist())
    setup = replace(given, **found)
    for box in () if setup.fixed else support_boxes(setup):
        if (height := 2 * box.half_extents[2]) <= 0:
            raise ParameterError(
                f"setup has the object's underside {height:.3f} m above its table at the {box.kind}: it must be above 0 m"
            )
    # A first action places the wrist; HPAC-Grasp-v0 draws boxes with up to five points of the thumb.
    if not task.wrist_actions and points_in_object(setup) > 6:
        raise ParameterError(
            f"setup has the hand inside its object, which is at {setup.position.tolist()} m in the hand's frame"
        )
    task.check(setup)
    return setup
