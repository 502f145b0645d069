"""What a caller gets wrong: one error of the library's own that names the value, and no episode that goes on in silence."""

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from importlib.util import find_spec

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.utils.env_checker import data_equivalence

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs import Grasp, HandEnv, PostureEnv
from hpac_gym.envs.options import IDS, OPTIONS, checked_options
from hpac_gym.envs.randomization import Randomization
from hpac_gym.errors import EpisodeError, HpacError, ParameterError, ShapeError, WorkspaceError
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.tasks.cameras import CameraNoise
from tests.envs.episodes import EASY

MAKERS: dict[str, Callable[[], gymnasium.Env]] = {
    "HandEnv": lambda: HandEnv(Grasp()),
    "PostureEnv": PostureEnv,
    "made by its id": lambda: gymnasium.make("HPAC-Grasp-v0", grasp="rod"),
}


@pytest.fixture(params=IDS)
def env(request):
    with gymnasium.make(request.param) as made:
        yield made


CHOICES = [option for option in OPTIONS if option.values and not option.others]


@pytest.mark.parametrize("option", CHOICES, ids=lambda option: option.name)
def test_an_option_takes_the_values_of_its_table_and_no_other(option):
    """What needs an engine that is not there says so."""
    given = {"grasp": "rod"} if option.name == "variant" else {}
    for value in option.values:
        if value != "light" and (value != "pybullet" or find_spec("pybullet")):
            gymnasium.make(option.ids[0], **given, **{option.name: value}).close()
    for wrong in ("nonsense", 3, ["nonsense"]):
        with pytest.raises(HpacError, match=r"nonsense|3"):
            gymnasium.make(option.ids[0], **given, **{option.name: wrong})


@pytest.mark.parametrize("name", IDS)
def test_an_id_takes_the_defaults_of_its_table_and_no_other_option(name):
    with gymnasium.make(name) as plain, gymnasium.make(name, **{o.name: o.default for o in OPTIONS if name in o.ids}) as given:
        seen, expected = given.reset(seed=0)[0], plain.reset(seed=0)[0]
        assert data_equivalence(seen, expected)
    for other in ("task", "max_steps", "workers"):
        with pytest.raises(TypeError, match=other):
            gymnasium.make(name, **{other: None})
    for option in OPTIONS:
        if name not in option.ids:
            with pytest.raises((TypeError, ParameterError), match=option.name):
                gymnasium.make(name, **{option.name: CameraNoise(0, 0, 0) if option.name == "noise" else None})


def test_the_defaults_of_the_table_are_those_of_the_check():
    parameters = inspect.signature(checked_options).parameters
    table = {option.name: option.default for option in OPTIONS if option.name not in ("grasp", "variant")}
    assert {name: parameter.default for name, parameter in parameters.items()} == table


@pytest.mark.parametrize("take", [copy.copy, copy.deepcopy, pickle.dumps], ids=["copy", "deepcopy", "pickle"])
@pytest.mark.parametrize("made", MAKERS)
def test_what_has_a_physics_world_cannot_be_copied(made, take):
    original = MAKERS[made]()
    if take is copy.copy and made == "made by its id":
        take = lambda env: copy.copy(env.unwrapped)  # noqa: E731  a wrapper's own copy wraps the same environment
    with pytest.raises(TypeError, match="a physics world cannot be copied or pickled: make a new"):
        take(original)
    original.close()


def a_setup(**change) -> SceneSetup:
    return dataclasses.replace(EASY, **change)


SETUPS = [
    ({"setup": "nonsense"}, ParameterError, "SceneSetup.*'nonsense'"),
    ({"setup": 0}, ParameterError, "SceneSetup.*0"),
    ({"setup": a_setup(object="rod")}, ParameterError, "ObjectSpec.*'rod'"),
    ({"setpu": None}, ParameterError, "'setpu'.*'setup'"),
    ("setup", ParameterError, "'setup'.*None or"),
    ({"setup": a_setup(position=np.array([0.05, np.nan, 0.1]))}, ShapeError, r"setup position\[1\] = nan"),
    ({"setup": a_setup(position=np.zeros(2))}, ShapeError, r"setup position.*\(2,\)"),
    ({"setup": a_setup(yaw=np.nan)}, ShapeError, r"setup yaw.* = nan"),
    ({"setup": a_setup(synergy=np.full(6, np.inf))}, ShapeError, r"setup synergy\[0\] = inf"),
    ({"setup": a_setup(hand_quaternion=(0.5, 0.5, 0.5, np.nan))}, ShapeError, r"setup hand_quaternion\[3\] = nan"),
    ({"setup": a_setup(object_quaternion=(0.0, 0.0, 1.0))}, ShapeError, r"setup object_quaternion.*\(3,\)"),
    ({"setup": a_setup(target=np.array([0.0, 0.0, np.nan]))}, ShapeError, r"setup target\[2\] = nan"),
]
GOALS = [
    ({"goal": np.full(15, 9.0)}, WorkspaceError, r"goal thumb_ip = 9 rad is outside \[-0.5, 2\] rad"),
    ({"goal": -0.6 * np.eye(15)[4]}, WorkspaceError, r"goal index_mcp = -0.6 rad is outside \[-0.5, 2\] rad"),
    ({"goal": np.full(15, np.nan)}, ShapeError, r"goal\[0\] = nan"),
    ({"goal": "fist"}, ShapeError, "goal must be an array of numbers"),
    ({"goals": np.zeros(15)}, ParameterError, "'goals'.*'goal'"),
    ([], ParameterError, r"\[\].*'goal'"),
]


@pytest.mark.parametrize(
    ("make", "options", "error", "message"),
    [("HandEnv", *row) for row in SETUPS] + [("PostureEnv", *row) for row in GOALS],
)
def test_a_reset_that_is_refused_names_what_is_wrong_and_leaves_no_episode_running(make, options, error, message):
    env = MAKERS[make]()
    env.reset(seed=0)
    with pytest.raises(error, match=message):
        env.reset(options=options)
    with pytest.raises(EpisodeError, match="reset"):
        env.step(np.zeros(6, np.float32))
    env.reset(seed=0, options={})
    env.step(np.zeros(6, np.float32))
    env.close()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_an_object_is_of_finite_size_mass_and_friction(value):
    spec = {"shape": "box", "half_extents": (0.02, 0.02, 0.02), "mass": 0.1, "friction": 0.8}
    for wrong in ({"half_extents": (0.02, value, 0.02)}, {"mass": value}, {"friction": value}, {"scale": value}):
        with pytest.raises(ValueError, match="finite"):
            ObjectSpec(**spec | wrong)


@pytest.mark.parametrize(
    ("name", "wrong", "named"),
    [
        ("randomize", 0, "randomize 0 is none of nominal"),
        ("randomize", False, "randomize False is none of nominal"),
        ("randomize", "", "randomize '' is none of nominal"),
        ("randomize", ["full"], r"randomize \['full'\] is none of nominal"),
        ("randomize", {"servo_lga": (0.0, 0.1)}, "servo_lga.*servo_lag"),
        ("randomize", {"servo_lag": 0.1}, r"servo_lag = 0.1 must be a range .* \[0, 0.15\]"),
        ("grasp", ["rod"], r"no grasp \['rod'\]"),
        ("grasp", 3, "no grasp 3"),
        ("hand", 3, "hand 3 is neither"),
        ("hand", None, "hand None is neither"),
        ("noise", None, "noise None is not a CameraNoise"),
        ("noise", {"position": 0.0}, "is not a CameraNoise"),
        ("noise", CameraNoise(angle=-0.1), "at least 0"),
        ("noise", CameraNoise(size=float("nan")), "finite"),
    ],
)
def test_an_argument_of_a_wrong_type_is_named(name, wrong, named):
    with pytest.raises(HpacError, match=named):
        gymnasium.make("HPAC-Grasp-v0", **{name: wrong})
    if name in ("randomize", "hand"):
        with pytest.raises(ParameterError, match=named):
            PostureEnv(**{name: wrong})


def test_a_variant_of_a_wrong_type_is_named():
    with pytest.raises(HpacError, match=r"no variant \['large'\]"):
        gymnasium.make("HPAC-Grasp-v0", grasp="rod", variant=["large"])


@pytest.mark.parametrize("name", ["servo_lag", "slack", "object_mass"])
@pytest.mark.parametrize("wrong", [0.1, None, (), (0.1,), (0.0, 0.1, 0.2), "ab", ("0", "1")])
def test_a_range_is_a_pair_of_numbers(name, wrong):
    with pytest.raises(ParameterError, match=name):
        Randomization(**{name: wrong})


@pytest.mark.parametrize("randomize", [Randomization(servo_lag=(0.0, 0.1), slack=(0.0, 1e-3)), {"servo_lag": [0, 0.1]}, {}])
def test_ranges_survive_json_and_give_the_same_episode(randomize):
    with gymnasium.make("HPAC-Posture-v0", randomize=randomize) as env:
        again = gymnasium.make(EnvSpec.from_json(env.spec.to_json()))
        assert again.unwrapped.randomization == env.unwrapped.randomization
        observation, info = env.reset(seed=3)
        same, told = again.reset(seed=3)
        assert info["randomized"] == told["randomized"]
        np.testing.assert_array_equal(observation["achieved_goal"], same["achieved_goal"])
        again.close()


def test_an_action_that_float32_rounds_past_its_bound_is_that_bound(env):
    beyond = np.nextafter(np.ones(6, np.float32), np.float32(2))
    assert (beyond > 1).all()
    commands = []
    for action in (np.ones(6, np.float32), beyond):
        env.reset(seed=0)
        env.step(action)
        commands.append(env.unwrapped.command.servo)
    np.testing.assert_array_equal(*commands)
    with pytest.raises(WorkspaceError, match=r"action thumb_mp = 1\.00001 "):
        env.step(np.full(6, 1.00001))


@pytest.mark.parametrize(
    "action", [np.full(6, 0.5 + 0.5j), np.array(["0.5"] * 6), ["0.5"] * 6, "open", None, np.zeros(5), np.zeros((2, 6))]
)
def test_an_action_that_is_not_six_real_numbers_is_refused(env, action):
    env.reset(seed=0)
    with pytest.raises(ShapeError, match="must"):
        env.step(action)
