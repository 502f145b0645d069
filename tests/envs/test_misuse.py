"""What a caller gets wrong: one error of the library's own that names the value, and no episode
that goes on in silence.
"""

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import data_equivalence

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs import GoalEnv, Grasp, HandEnv, HandVectorEnv, Posture
from hpac_gym.envs.options import COMMON
from hpac_gym.envs.randomization import Randomization
from hpac_gym.envs.registered import options_of_id
from hpac_gym.errors import EpisodeError, HpacError, ParameterError, ShapeError, WorkspaceError
from hpac_gym.model import HPAC
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, IDS, PICK_PLACE, POSTURE
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grasp import GraspConfig, GraspWeights
from hpac_gym.tasks.phases import Timetable
from hpac_gym.tasks.posture import PostureConfig
from hpac_gym.tasks.terms import GRASP_CENTRE, LENGTH_UNIT
from tests.envs.episodes import EASY, check_stopped, part

MAKERS: dict[str, Callable[[], Any]] = {
    "HandEnv": lambda: HandEnv(Grasp()),
    "GoalEnv": lambda: GoalEnv(Posture()),
    "HandVectorEnv": lambda: HandVectorEnv(Grasp(), 2),
    "made by its id": lambda: gymnasium.make("HPAC-Grasp-v0", grasp="rod"),
}


@pytest.mark.pybullet
@pytest.mark.parametrize("make", [HandEnv, HandVectorEnv])
def test_an_engine_is_closed_where_an_environment_is_refused(monkeypatch, make):
    closed = []
    monkeypatch.setattr(
        "hpac_gym.physics.pybullet.engine.PyBulletEngine.close",
        lambda engine: closed.append(engine),
    )
    with pytest.raises(ParameterError, match="hub_inertia"):
        make(Grasp(), engine="pybullet", body="light")
    assert len(closed) == 1


OPTIONS = {name: options_of_id(name) for name in IDS}
COMMON_NAMES = {option.name for option in COMMON}
CHOICES = [
    pytest.param(name, option, id=f"{name} {option.name}")
    for name, options in OPTIONS.items()
    for option in options
    if option.values and not option.others
    if name == GRASP or option.name == "obs" or option.name not in COMMON_NAMES
]


@pytest.mark.parametrize(("name", "option"), CHOICES)
def test_an_option_takes_the_values_of_its_table_and_no_other(name, option):
    """What needs an engine that is not there says so; Gymnasium itself reads the render mode."""
    given = {"grasp": "rod"} if option.name == "variant" else {}
    for value in option.values:
        if value != "light" and (value != "pybullet" or find_spec("pybullet")):
            gymnasium.make(name, **given, **{option.name: value}).close()
    for wrong in ("nonsense", 3, ["nonsense"])[: 1 if option.name == "render_mode" else 3]:
        with pytest.raises(HpacError, match=r"nonsense|3"):
            gymnasium.make(name, **given, **{option.name: wrong})


@pytest.mark.parametrize("name", IDS)
def test_an_id_takes_the_defaults_of_its_table_and_no_other_option(name):
    with (
        gymnasium.make(name) as plain,
        gymnasium.make(name, **{o.name: o.default for o in OPTIONS[name]}) as given,
    ):
        assert data_equivalence(given.reset(seed=0)[0], plain.reset(seed=0)[0])
    for other in ("task", "max_steps", "workers", "world"):
        with pytest.raises(TypeError, match=other):
            gymnasium.make(name, **{other: None})
    taken = {option.name for option in OPTIONS[name]}
    others = {option.name for options in OPTIONS.values() for option in options} - taken
    for other in others:
        with pytest.raises((TypeError, ParameterError), match=other):
            gymnasium.make(name, **{other: CameraNoise(0, 0, 0) if other == "noise" else None})


@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_an_unknown_option_is_refused_with_those_that_the_id_has(make):
    for name in IDS:
        known = ", ".join(option.name for option in OPTIONS[name])
        with pytest.raises(TypeError, match=f"unknown options foo: there are {known}( |$)"):
            make(name, foo=1)


@pytest.mark.parametrize(
    "take", [copy.copy, copy.deepcopy, pickle.dumps], ids=["copy", "deepcopy", "pickle"]
)
@pytest.mark.parametrize("made", MAKERS)
def test_what_has_a_physics_world_cannot_be_copied(made, take, opened):
    original = opened(MAKERS[made]())
    if take is copy.copy and made == "made by its id":
        take = lambda env: copy.copy(env.unwrapped)  # noqa: E731  a wrapper's own copy wraps the same environment
    with pytest.raises(TypeError, match="a physics world cannot be copied or pickled: make a new"):
        take(original)


@pytest.mark.parametrize("make", [HandEnv, HandVectorEnv])
def test_of_two_environments_with_one_task_the_first_says_so(make, opened):
    """The task holds the arrays of both: each would be judged by what the other does."""
    task = Grasp()
    first = opened(make(task))
    first.reset(seed=0)
    second = opened(make(task))
    second.reset(seed=0)
    for call in (first.reset, first.render, lambda: first.step(first.action_space.sample())):
        with pytest.raises(EpisodeError, match="given to another: make one for each"):
            call()
    second.step(second.action_space.sample())


def interrupted(monkeypatch, env, place: str, call: Callable[[], object]) -> None:
    """Make a call that Ctrl-C interrupts where it comes to a place of `hpac_gym`; no episode is
    running then.
    """

    def stop(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):  # noqa: PT012
        patched.setattr(f"hpac_gym.{place}", stop)
        call()
    check_stopped(env)


def test_after_an_interrupted_step_only_a_reset_or_a_saved_state_goes_on(monkeypatch, opened):
    """Wrist and servos would be a step ahead of the hand, and an episode would end twice."""
    still = np.zeros(6)
    env = opened(HandEnv(Grasp()))
    env.reset(seed=0)
    state = env.save_state()
    expected = env.step(still)
    advance = "physics.simulation.Simulation.advance"
    interrupted(monkeypatch, env, advance, lambda: env.step(still))
    interrupted(monkeypatch, env, "envs.hand_env.restore", lambda: env.restore_state(state))
    env.restore_state(state)
    assert data_equivalence(env.step(still), expected, exact=True)
    interrupted(monkeypatch, env, "envs.commands.Wrists.start", lambda: env.reset(seed=0))
    with pytest.raises(EpisodeError, match="only in the episode"):
        env.restore_state(state)
    env.reset(seed=0)
    assert data_equivalence(env.step(still), expected, exact=True)

    envs = opened(HandVectorEnv(Grasp(), 2, max_episode_steps=1))
    mask = {"reset_mask": np.array([True, False])}
    for place, ended in ((advance, 0), ("envs.vector_env.HandVectorEnv._restart", 1)):
        envs.reset(seed=0)
        for _ in range(ended):
            assert envs.step(np.zeros((2, 6)))[3].all()
        interrupted(monkeypatch, envs, place, lambda: envs.step(np.zeros((2, 6))))
        with pytest.raises(ParameterError, match="no episode is running"):
            envs.reset(options=mask)


def a_setup(**change) -> SceneSetup:
    return replace(EASY, **change)


SETUPS = [
    ({"setup": "nonsense"}, ParameterError, "SceneSetup.*'nonsense'"),
    ({"setup": 0}, ParameterError, "SceneSetup.*0"),
    ({"setup": a_setup(object="rod")}, ParameterError, "ObjectSpec.*'rod'"),
    ({"setup": a_setup(hand="mine.toml")}, ParameterError, "of type Hand, not 'mine.toml'"),
    ({"setup": a_setup(hand_settings={})}, ParameterError, "of type HandSettings, not {}"),
    ({"setup": a_setup(support=(0.1, 0.1))}, ParameterError, "of type Support or NoneType, not"),
    (
        {"setup": a_setup(position=np.array([0.0, 0.004, 0.112]))},
        ParameterError,
        r"hand inside its object, which is at \[0\.0, 0\.004, 0\.112\] m",
    ),
    ({"setup": a_setup(fixed="no")}, ParameterError, "setup fixed must be of type bool, not 'no'"),
    ({"setup": a_setup(rest_height=0.9)}, ParameterError, "object's underside -0.[0-9]+ m above"),
    (
        {"setup": a_setup(target=np.array([0.0, -2.0, 0.0]))},
        ParameterError,
        "at the target: it must",
    ),
    ({"setpu": None}, ParameterError, "'setpu'.*'setup'"),
    ("setup", ParameterError, "'setup'.*None or"),
    (
        {"setup": a_setup(position=np.array([0.05, np.nan, 0.1]))},
        ShapeError,
        r"setup position\[1\] = nan",
    ),
    ({"setup": a_setup(position=np.zeros(2))}, ShapeError, r"setup position.*\(2,\)"),
    ({"setup": a_setup(yaw=np.nan)}, ParameterError, r"setup yaw.* = nan"),
    ({"setup": a_setup(synergy=np.full(6, np.inf))}, ShapeError, r"setup synergy\[0\] = inf"),
    (
        {"setup": a_setup(hand_quaternion=(0.5, 0.5, 0.5, np.nan))},
        ShapeError,
        r"setup hand_quaternion\[3\] = nan",
    ),
    (
        {"setup": a_setup(object_quaternion=(0.0, 0.0, 1.0))},
        ShapeError,
        r"setup object_quaternion.*\(3,\)",
    ),
    (
        {"setup": a_setup(target=np.array([0.0, 0.0, np.nan]))},
        ShapeError,
        r"setup target\[2\] = nan",
    ),
    *(
        (
            {"setup": a_setup(**{name: wrong})},
            ParameterError,
            f"setup {name}.* of norm {norm}: must",
        )
        for name, wrong, norm in (
            ("hand_quaternion", (2.0, 0.0, 0.0, 2.0), "2.82843"),
            ("object_quaternion", (1, 0, 0, 1), "1.41421"),
            ("object_quaternion", np.zeros(4), "0"),
        )
    ),
]
GOALS = [
    (
        {"goal": np.full(15, 9.0)},
        WorkspaceError,
        r"goal thumb_ip = 9 rad is outside \[-0.5, 2\] rad",
    ),
    (
        {"goal": -0.6 * np.eye(15)[4]},
        WorkspaceError,
        r"goal index_mcp = -0.6 rad is outside \[-0.5, 2\] rad",
    ),
    ({"goal": np.full(15, np.nan)}, ShapeError, r"goal\[0\] = nan"),
    ({"goal": np.zeros(6)}, ShapeError, r"goal must have shape \(..., 15\), not \(6,\)"),
    ({"goal": "fist"}, ShapeError, "goal must be an array of numbers"),
    ({"goals": np.zeros(15)}, ParameterError, "'goals'.*'goal'"),
    ([], ParameterError, r"\[\].*'goal'"),
]


@pytest.mark.parametrize(
    ("make", "options", "error", "message"),
    [("HandEnv", *row) for row in SETUPS]
    + [("HandVectorEnv", *row) for row in SETUPS[:1]]
    + [("GoalEnv", *row) for row in GOALS],
)
def test_a_reset_that_is_refused_names_what_is_wrong_and_leaves_no_episode_running(
    make, options, error, message, opened
):
    env = opened(MAKERS[make]())
    env.reset(seed=0)
    with pytest.raises(error, match=message):
        env.reset(options=options)
    check_stopped(env)
    env.reset(seed=0, options={})
    env.step(np.zeros(env.action_space.shape, np.float32))


@pytest.mark.parametrize(
    ("env_id", "change", "message"),
    [
        (GENTLE, {"crush_limit": np.nan}, "setup crush_limit = nan N must be a number within"),
        (
            GENTLE,
            {"crush_limit": 0.0},
            r"crush_limit = 0.0 N must be a number within \[0.1, 1000\]",
        ),
        (GENTLE, {"crush_limit": "x"}, "crush_limit = 'x' N must be a number"),
        (GRASP, {"rest_height": -1.0}, r"rest_height = -1.0 m must be a number within \]0, 1\] m"),
        (GRASP, {"rest_height": np.nan}, "rest_height = nan m"),
        (GRASP_ANY, {"pull": np.array([0.0, 0.0, 10.0])}, "setup pull = .* of norm 10: must be 1"),
        (GRASP_ANY, {"pull": np.zeros(3)}, "setup pull = .* of norm 0: must be 1"),
        (
            GRASP_ANY,
            {"pull": np.array([np.nan, 0.0, 1.0])},
            r"setup pull\[0\] = nan must be a finite",
        ),
        (GRASP_ANY, {"pull": np.ones(2)}, r"setup pull must have shape \(..., 3\), not \(2,\)"),
        (GRASP_TYPE, {"grasp": ["rod"]}, r"setup grasp \['rod'\] is not one of"),
        (PICK_PLACE, {"target": None}, "a setup of PickPlace needs a target"),
        (
            PICK_PLACE,
            {"hand_quaternion": (0.0, 0.0, 0.0, 1.0)},
            "hand_quaternion = .* no other than",
        ),
    ],
)
def test_a_setup_that_is_no_episode_of_its_task_is_refused(env_id, change, message):
    with gymnasium.make(env_id) as env:
        env.reset(seed=0)
        (drawn,) = env.unwrapped.episodes.setups
        env.reset(options={"setup": drawn})
        with pytest.raises(HpacError, match=message):
            env.reset(options={"setup": replace(drawn, **change)})


def test_a_setup_of_lists_is_that_of_its_arrays_and_tuples():
    with gymnasium.make("HPAC-GraspAny-v1", engine="mujoco", wrist="free") as env:
        env.reset(seed=3)
        plain = replace(env.unwrapped.episodes.setups[0], object=OWN)
        names = ("position", "synergy", "hand_quaternion", "object_quaternion")
        lists = {name: np.asarray(getattr(plain, name)).tolist() for name in names}
        listed = replace(OWN, half_extents=list(OWN.half_extents))
        seen = []
        for given in (plain, replace(plain, **lists, object=listed)):
            env.reset(seed=3, options={"setup": given})
            seen.append(env.step(np.full(10, 0.2, np.float32))[0])
    np.testing.assert_array_equal(*seen)


def test_a_quaternion_of_four_digits_is_taken_and_made_one():
    with gymnasium.make("HPAC-Grasp-v0") as env:
        env.reset(options={"setup": a_setup(object_quaternion=(0, 0, 0.7071, 0.7071))})
        (taken,) = env.unwrapped.episodes.setups
    assert np.linalg.norm(taken.object_quaternion) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_object_is_of_finite_size_mass_and_friction(value):
    spec = {"shape": "box", "half_extents": (0.02, 0.02, 0.02), "mass": 0.1, "friction": 0.8}
    for wrong in (
        {"half_extents": (0.02, value, 0.02)},
        {"mass": value},
        {"friction": value},
        {"scale": value},
    ):
        with pytest.raises(ParameterError, match=r"must be .* within"):
            ObjectSpec(**spec | wrong)


OWN = ObjectSpec("box", (0.02, 0.02, 0.05), mass=0.1, friction=0.8)
PRESET = r"randomize must be a preset \(nominal, .*; got "


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (GRASP, {"randomize": 0}, PRESET + "0"),
        (GRASP, {"randomize": False}, PRESET + "False"),
        (GRASP, {"randomize": ""}, PRESET + "''"),
        (GRASP, {"randomize": "wild"}, PRESET + "'wild'"),
        (GRASP, {"randomize": ["full"]}, PRESET + r"\['full'\]"),
        (POSTURE, {"randomize": 0}, PRESET + "0"),
        (GRASP, {"randomize": {"servo_lga": (0.0, 0.1)}}, "servo_lga.*servo_lag"),
        (
            GRASP,
            {"randomize": {"servo_lag": 0.1}},
            r"servo_lag = 0.1 s must be a range .* \[0, 0.15\] s",
        ),
        (GRASP, {"grasp": ["rod"]}, r"no grasp \['rod'\]"),
        (GRASP, {"grasp": 3}, "no grasp 3"),
        (GRASP, {"grasp": "cylinder"}, "'cylinder'.*large_cylinder"),
        (
            GRASP,
            {"object": ObjectSpec("sphere", (0.08, 0.08, 0.08), mass=0.1, friction=0.8)},
            "0.16 x 0.16 x 0.16 m, does not fit in front of the open hand",
        ),
        (GRASP, {"grasp": "rod", "variant": "huge"}, "'huge'.*slippery"),
        (GRASP, {"grasp": "rod", "variant": ["large"]}, r"no variant \['large'\]"),
        (GRASP, {"variant": "large"}, "needs a named grasp"),
        (GRASP, {"hand": 3}, "hand 3 is neither"),
        (GRASP, {"hand": "no_such.toml"}, "no_such.toml"),
        (GRASP, {"model": 3}, "model 3 is neither a Hand nor the path of a hand file"),
        (GRASP_ANY, {"model": "calibrated"}, "it needs hands='test', not 'nominal'"),
        (GRASP, {"hand": None}, "hand None is neither"),
        (POSTURE, {"hand": 3}, "hand 3 is neither"),
        (GRASP, {"noise": 0.0}, "noise 0.0 is neither a CameraNoise nor a mapping"),
        (
            GRASP,
            {"noise": {"positon": 0.0}},
            "noise has no field 'positon'; it has position, angle, size",
        ),
        (
            GRASP,
            {"noise": {"position": "0"}},
            r"noise position = '0' m must be a number within \[0, inf\[",
        ),
        (
            GRASP,
            {"noise": {"angle": -1}},
            r"noise angle = -1 rad must be a number within \[0, inf\[",
        ),
        (GRASP, {"noise": {"size": float("nan")}}, "noise size = nan must be a number within"),
        (GRASP, {"obs": "load"}, "obs 'load' is not one of deploy, privileged, image"),
        (GRASP, {"config": "easy"}, "config 'easy' is neither a GraspConfig nor a mapping"),
        (POSTURE, {"config": "easy"}, "config 'easy' is neither a PostureConfig nor a mapping"),
        (GRASP, {"config": {"radii": [0.01, 0.02]}}, "config has no field 'radii'; it has radius"),
        (
            GRASP,
            {"config": {"radius": 0.01}},
            r"config radius = 0.01 .*a range .*, such as \[0.01, 0.01\]$",
        ),
        (GRASP, {"config": {"radius": 9}}, r"config radius = 9 .*within \[0.002, 0.06\] m$"),
        (
            GRASP,
            {"config": {"radius": [0.03, 0.01]}},
            r"config radius = .*must be a range .*within \[0.002, 0.06\]",
        ),
        (
            GRASP,
            {"config": {"mass": [0.0, 0.1]}},
            r"config mass = .* kg must .*within \[0.001, 2\] kg",
        ),
        (
            GRASP,
            {"config": {"drop_distance": True}},
            "config drop_distance = True m must be a number within",
        ),
        (
            GRASP,
            {"config": {"weights": {"carry": None}}},
            "config weights carry = None must be a finite number",
        ),
        (
            GRASP,
            {"config": {"weights": GraspWeights(carry=np.nan)}},
            "config weights carry = nan must be a finite number",
        ),
        (
            GRASP,
            {"config": {"timetable": 2.0}},
            "config timetable 2.0 is neither a Timetable nor a mapping",
        ),
        (
            GRASP,
            {"config": {"timetable": {"close_time": -1.0}}},
            r"timetable close_time = -1.0 s must be a number within \]0, inf\[ s",
        ),
        (
            GRASP,
            {"config": {"timetable": {"close_time": np.inf}}},
            r"timetable close_time = inf s must be a number within \]0, inf\[ s",
        ),
        (
            GRASP,
            {"config": {"timetable": {"close_time": 2.0}}},
            r"lasts 80 steps: HPAC-Grasp-v0 .* 64; use .*HandEnv\(Grasp",
        ),
        (
            GRASP,
            {
                "grasp": "rod",
                "config": {"mass": [0.1, 0.2], "box_yaw": [0.0, 0.1], "drop_distance": 0.05},
            },
            "config mass, box_yaw: a named grasp such as 'rod' has its own object",
        ),
        (
            GRASP,
            {
                "object": OWN,
                "config": {"mass": [0.1, 0.2], "gap": [0.0, 0.01], "radius": [0.01, 0.02]},
            },
            "config radius, mass: an object of one's own has its own size, mass and friction",
        ),
        (
            GRASP,
            {
                "config": {
                    "timetable": dict.fromkeys(
                        ("close_time", "lift_time", "shake_time", "place_time"), 0.001
                    )
                }
            },
            "an episode of 0.004 s must have a control step of 0.05 s, and an end",
        ),
        (PICK_PLACE, {"config": {"timetable": {"carry": [1, 1, 1]}}}, "has no field 'carry'"),
        (
            PICK_PLACE,
            {"config": {"timetable": {"reach": [np.nan, 0.0, 0.0]}}},
            r"timetable reach = \[nan, 0.0, 0.0\] m must be 3 values within \]-inf, inf\[ m",
        ),
        (
            PICK_PLACE,
            {"config": {"timetable": {"lift_height": -0.1}}},
            r"timetable lift_height = -0.1 m must be a number within \[0, inf\[ m",
        ),
        (
            GENTLE,
            {"config": {"sphere_radius": [0.025, 0.03]}},
            "config sphere_radius: there are no spheres",
        ),
        (
            GENTLE,
            {"config": {"crush_limit": [0.0, 1.0]}},
            r"config crush_limit = .* within \[0.1, 1000\]",
        ),
        (
            POSTURE,
            {"config": {"duration": 3.0}},
            r"config duration = 3.0 s: give .*max_episode_steps",
        ),
        (GRASP_ANY, {"objects": "reel"}, "objects 'reel' is not one of train, wide, test, real"),
        (GRASP_ANY, {"wrist": "loose"}, "wrist 'loose' is not one of script, free"),
        (GRASP_ANY, {"hands": "left"}, "hands 'left' is not one of nominal, train, test"),
        (GRASP_ANY, {"hands": "test", "hand": replace(HPAC, name="mine")}, "give either"),
        (GRASP_ANY, {"obs": "touch"}, "obs 'touch' is not one of .*load, points"),
        (
            GRASP_ANY,
            {"config": {"side_time": 0.07}},
            "side_time = 0.07 s must be a multiple of 0.05 s",
        ),
        (
            GRASP_ANY,
            {"config": {"timetable": {"close_time": 2.97}}},
            "config timetable: the end of the shake = 4.47 s must be a multiple of 0.05 s",
        ),
        (GRASP_ANY, {"config": {"size": [0.1, 3.0]}}, "config size"),
        (GRASP_ANY, {"config": {"ramp_force": 0}}, r"ramp_force = 0 .* within \]0, 1000\]"),
        (
            GRASP_ANY,
            {"config": {"width": [0.5, 0.6]}},
            r"width = \(0.5, 0.6\) m and flattest = 0.018 m exclude all train",
        ),
        (
            GRASP_TYPE,
            {"types": "club"},
            "no grasp type 'club'; there are all, train, test, large_cylinder",
        ),
        (GRASP_TYPE, {"objects": "real"}, "objects 'real' is not one of train, test"),
        (GRASP_TYPE, {"wrist": "loose"}, "wrist 'loose' is not one of free, script"),
        (GRASP_TYPE, {"obs": "load"}, "obs 'load' is not one of deploy, privileged, image"),
        (
            GRASP_TYPE,
            {"config": {"spread": 7}},
            r"config spread = 7 must be a number within \[0, 5\]",
        ),
        (
            GRASP_TYPE,
            {"config": {"timetable": {"close_time": 2.0}}},
            "lasts 80 steps: HPAC-GraspType-v0 has .*GraspByType",
        ),
    ],
)
def test_what_is_refused_is_named_in_one_line(name, options, message):
    with pytest.raises(HpacError, match=message) as error:
        gymnasium.make(name, **options)
    assert "\n" not in str(error.value)


def test_a_spec_that_names_the_hand_of_the_paper_can_be_made_again():
    with (
        gymnasium.make(GRASP_ANY, hand=HPAC, hands="train") as env,
        gymnasium.make(env.spec) as again,
    ):
        assert again.unwrapped.task.hands == "train"


def test_a_config_is_taken_where_it_says_nothing_of_the_object():
    gymnasium.make(
        GRASP, grasp="rod", config={"drop_distance": 0.05, "weights": {"success": 1.0}}
    ).close()
    gymnasium.make(GRASP, object=OWN, config={"gap": [0.0, 0.01]}).close()


RANGES = Randomization(servo_lag=(0.0, 0.1), slack=(0.0, 1e-3))
TIMES = {"timetable": {"close_time": 1.0}, "weights": {"success": 3.0}}


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("HPAC-Posture-v1", {"randomize": RANGES}),
        ("HPAC-Posture-v1", {"randomize": {"servo_lag": [0, 0.1]}}),
        ("HPAC-Posture-v1", {"randomize": {}, "config": PostureConfig(tolerance=0.02)}),
        ("HPAC-Grasp-v0", {"noise": CameraNoise(0.0, 0.01, 0.0), "randomize": "full"}),
        (
            "HPAC-Grasp-v0",
            {"noise": {"position": 0.0}, "config": {"radius": [0.02, 0.025], **TIMES}},
        ),
        (
            "HPAC-Grasp-v0",
            {"config": GraspConfig(mass=(0.1, 0.1), timetable=Timetable(close_time=1.1))},
        ),
        (
            "HPAC-GraspType-v0",
            {
                "types": ["rod", "hook"],
                "objects": "test",
                "config": {"spread": 2.0, "drop_distance": 0.05},
            },
        ),
        (
            "HPAC-GraspAny-v1",
            {
                "objects": "real",
                "hands": "train",
                "wrist": "free",
                "config": {"gap": [0.01, 0.01], **TIMES},
            },
        ),
        ("HPAC-PickPlace-v0", {"noise": {"size": 0}, "config": {"mass": (0.1, 0.1), **TIMES}}),
    ],
    ids=str,
)
def test_ranges_noise_and_config_survive_json_and_give_the_same_episode(name, given):
    with (
        gymnasium.make(name, **given) as env,
        gymnasium.make(EnvSpec.from_json(env.spec.to_json())) as again,
    ):
        assert again.unwrapped.randomization == env.unwrapped.randomization
        assert again.unwrapped.task.config == env.unwrapped.task.config
        assert again.spec.max_episode_steps == env.spec.max_episode_steps
        assert data_equivalence(env.reset(seed=3), again.reset(seed=3), exact=True)
        action = np.zeros(env.action_space.shape)
        assert data_equivalence(env.step(action), again.step(action), exact=True)


def test_what_is_given_counts():
    """A config, and a noise, that only looked as if they were taken."""
    with gymnasium.make(
        "HPAC-Grasp-v0",
        noise={"size": 0, "angle": 0, "position": 0},
        config={"mass": [0.3, 0.3], "timetable": {"close_time": 1.0}},
    ) as env:
        observation, _ = env.reset(seed=0)
        assert env.unwrapped.task.config.timetable == Timetable(close_time=1.0)
        assert env.unwrapped.episodes.setups[0].object.mass == 0.3
        centre = (env.unwrapped.state.object_pos[0] - GRASP_CENTRE) / LENGTH_UNIT
        np.testing.assert_allclose(
            part(observation, env.unwrapped.task.terms, "object_pos"), centre, atol=1e-6
        )
