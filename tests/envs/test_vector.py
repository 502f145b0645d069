"""`HandVectorEnv` against Gymnasium's vector environment of single ones, to the bit; and what
`make_vec` makes.
"""

import signal
import warnings
from dataclasses import replace
from functools import partial

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import FlattenObservation as VectorFlatten

from hpac_gym.envs import Grasp, HandVectorEnv
from hpac_gym.envs.episodes import open_episodes
from hpac_gym.errors import ParameterError, ShapeError, WorkspaceError
from hpac_gym.model import elastic_joints_from_servo, servo_from_action, streamed_servo
from hpac_gym.physics.engine import PhysicsWarning
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, IDS, PICK_PLACE, POSTURE
from tests.envs.episodes import EASY, check_stopped
from tests.processes import python, wait_for_the_end

CLOSED = np.array([0.28, 1, 1, 1, 1, 0.53])
"""Where the scripted closure ends, not rounded to single precision."""


def ours(name: str = GRASP, num_envs: int = 3, **options) -> HandVectorEnv:
    """All hands in one process."""
    return gymnasium.make_vec(name, num_envs, **options)


def gymnasiums(
    name: str = GRASP, num_envs: int = 3, autoreset_mode=AutoresetMode.NEXT_STEP, **options
) -> SyncVectorEnv:
    """Single environments side by side."""
    return SyncVectorEnv(
        [partial(gymnasium.make, name, **options)] * num_envs, autoreset_mode=autoreset_mode
    )


def actions(num_envs: int = 3, steps: int = 8, size: int = 6) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (steps, num_envs, size)).astype(np.float32)


def assert_same(one, other) -> None:
    """Equal to the bit, dtypes too, through dictionaries, tuples and arrays of objects."""
    assert data_equivalence(one, other, exact=True)


def same(twins, call: str, *given, **named):
    """What two vector environments return, which is the same."""
    one, other = (getattr(envs, call)(*given, **named) for envs in twins)
    assert_same(one, other)
    return one


def same_step(twins, action, mode: AutoresetMode):
    """What a step of both returns, after which those that have to be are reset."""
    seen = same(twins, "step", action)
    over = seen[2] | seen[3]
    if mode is AutoresetMode.DISABLED and over.any():
        same(twins, "reset", options={"reset_mask": over})
    return seen


@pytest.fixture
def envs(opened):
    return opened(ours())


@pytest.mark.parametrize(
    ("name", "options", "mode"),
    [
        *((name, {}, mode) for name in (GRASP, POSTURE) for mode in AutoresetMode),
        (
            GRASP,
            {"obs": "privileged", "randomize": "full", "reward": "sparse"},
            AutoresetMode.NEXT_STEP,
        ),
        (GRASP, {"grasp": "tip_pinch"}, AutoresetMode.DISABLED),
        (PICK_PLACE, {"randomize": "link"}, AutoresetMode.NEXT_STEP),
        (POSTURE, {"obs": "privileged"}, AutoresetMode.SAME_STEP),
    ],
    ids=str,
)
def test_everything_is_as_in_gymnasiums_own_over_the_ends_of_short_episodes(
    name, options, mode, opened
):
    options = options | {"max_episode_steps": 3, "autoreset_mode": mode}
    mine = opened(ours(name, **options))
    its = opened(gymnasiums(name, **options))
    assert mine.metadata == its.metadata
    for space in ("observation", "action", "single_observation", "single_action"):
        assert getattr(mine, f"{space}_space") == getattr(its, f"{space}_space")
    twins = mine, its
    same(twins, "reset", seed=5)
    for step, action in enumerate(actions()):
        if step == 1:  # so that the episodes do not all end at once
            same(twins, "reset", options={"reset_mask": np.array([False, True, False])})
        assert same_step(twins, action, mode)[0] in mine.observation_space


@pytest.mark.parametrize(
    ("engine", "reward", "mode"),
    [
        *(("mujoco", "dense", mode) for mode in AutoresetMode),
        pytest.param("pybullet", "sparse", AutoresetMode.SAME_STEP, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_everything_is_as_in_gymnasiums_own_over_the_ends_of_whole_episodes(
    engine, reward, mode, opened
):
    """Some won, some lost, at different times; an action that counts for nothing may be NaN."""
    options = {"engine": engine, "reward": reward, "autoreset_mode": mode}
    twins = opened(HandVectorEnv(Grasp(), 3, **options)), opened(gymnasiums(**options))
    assert_same(*(envs.reset(seed=[3, None, 8])[0][[0, 2]] for envs in twins))
    # So that MuJoCo's hand keeps it too.
    higher = replace(EASY, position=EASY.position + np.array([0.0, 0.0, 0.006]))
    same(twins, "reset", seed=[3, 4, 8], options={"setup": higher})
    outcomes = set()
    over = np.zeros(3, dtype=bool)
    for step in range(80):
        action = np.tile(CLOSED * min(1.0, step / 16) - (1 - min(1.0, step / 16)), (3, 1))
        action[2] = 0.1 * actions(1, 80)[step] - 0.9  # an open hand lifts nothing
        if mode is AutoresetMode.NEXT_STEP:
            action[over] = np.nan
        _, _, terminated, truncated, infos = same_step(twins, action, mode)
        over = terminated | truncated
        outcomes |= set(np.ravel(infos.get("final_info", infos)["outcome"]).tolist())
    assert outcomes >= {"running", "failure", "success"}


@pytest.mark.parametrize(
    ("name", "options", "noise"),
    [
        (GRASP_ANY, {"wrist": "free", "obs": "load"}, 1.0),
        (GRASP_TYPE, {}, 0.0),
        (GENTLE, {"obs": "load"}, 0.1),
        (GRASP_ANY, {"hands": "test", "objects": "real", "model": "calibrated"}, 1.0),
    ],
    ids=str,
)
def test_free_wrists_contacts_forces_and_models_are_as_in_gymnasiums_own(
    name, options, noise, opened
):
    """The script's actions, or with noise any."""
    twins = opened(ours(name, **options)), opened(gymnasiums(name, **options))
    scripts = [twins[0].task.script() for _ in range(3)]
    rng = np.random.default_rng(0)
    seen = same(twins, "reset", seed=5)
    for _ in range(35):
        action = np.array([script.act(row) for script, row in zip(scripts, seen[0], strict=True)])
        action = np.clip(action + noise * rng.uniform(-1, 1, action.shape), -1, 1)
        seen = same(twins, "step", action)


@pytest.mark.parametrize("num_envs", [2, 64])
@pytest.mark.parametrize(
    ("function", "low", "high"),
    [
        (servo_from_action, -1, 1),
        (elastic_joints_from_servo, 0, 1.3),
        (lambda servo: streamed_servo(servo, servo[:, ::-1], 0.05), 0, 1.3),
    ],
    ids=["servo", "joints", "stream"],
)
def test_the_servos_of_many_hands_are_to_the_bit_those_of_each(function, low, high, num_envs):
    """A matrix product of many rows is rounded in another way than one of a single row."""
    for batch in np.random.default_rng(0).uniform(low, high, (50, num_envs, 6)):
        each = [function(batch[row : row + 1]) for row in range(num_envs)]
        np.testing.assert_array_equal(function(batch), np.concatenate(each))


def test_what_was_returned_stays_as_it_was(envs):
    action = actions()[0]
    results = [envs.reset(seed=0)[0], *envs.step(action)[:4]]
    copies = [result.copy() for result in results]
    action[:] = 0.7  # the caller may write the next one over it
    envs.step(actions()[1])
    assert_same(results, copies)


def test_seeds_and_generators_are_told_as_by_gymnasiums_own(envs, opened):
    """Of the episodes that a mask marks, which is left as it was given."""
    its = opened(gymnasiums())
    mask = {"reset_mask": np.array([True, False, True])}
    for given in ({"seed": 5}, {"seed": [7, 8, None], "options": mask}):
        envs.reset(**given)
        its.reset(**given | {"options": dict(mask) if "options" in given else None})
        assert envs.np_random_seed == its.np_random_seed
        states = [
            [generator.bit_generator.state for generator in each.np_random] for each in (envs, its)
        ]
        assert states[0] == states[1]


def test_pictures_are_those_of_single_environments(opened):
    options = {"render_mode": "rgb_array", "obs": "image"}
    mine = opened(ours(num_envs=2, **options))
    env = opened(gymnasium.make(GRASP, **options))
    (seen, _) = mine.reset(seed=0)
    (alone, _) = env.reset(seed=1)
    np.testing.assert_array_equal(seen["image"][1], alone["image"])
    frames = mine.render()
    assert len(frames) == 2
    np.testing.assert_array_equal(frames[1], env.render())


def test_a_refused_action_is_named_as_alone_with_its_environment_and_the_rest_goes_on(envs):
    bad = np.zeros((3, 6))
    bad[2, 1] = np.nan
    with gymnasium.make(GRASP) as env:
        env.reset(seed=0)
        with pytest.raises(WorkspaceError) as alone:
            env.step(bad[2])
    first, _ = envs.reset(seed=0)
    with pytest.raises(WorkspaceError) as caught:
        envs.step(bad)
    assert str(caught.value).replace("actions", "action") == str(alone.value)
    assert caught.value.__notes__ == ["in environment 2"]
    envs.step(np.zeros((3, 6)))
    np.testing.assert_array_equal(envs.reset(seed=0)[0], first)


def fail(envs, world: int) -> None:
    """Give the hand of a world in MuJoCo a speed with which no simulation can go on."""
    open_episodes(envs.unwrapped).simulation.engine._group_of[world].qvel[world] = np.nan


@pytest.mark.parametrize("name", IDS)
def test_a_failed_simulation_ends_its_episode_as_a_failure_and_the_others_go_on(name, opened):
    options = {"wrist": "script"} if name == GRASP_TYPE else {}
    envs, alone = (opened(VectorFlatten(ours(name, **options))) for _ in range(2))
    for each in (envs, alone):
        each.reset(seed=0)
        each.step(np.zeros(each.action_space.shape))
    action = np.full(envs.action_space.shape, 0.5, np.float32)
    fail(envs, 1)
    with pytest.warns(
        PhysicsWarning,
        match=r"^world 1 of 3 failed after 0\.050 s of its episode: MuJoCo says \w+; it ends as",
    ):
        seen, rewards, terminated, truncated, infos = envs.step(action)
    expected = alone.step(action)
    assert terminated.tolist() == [False, True, False]
    assert name == POSTURE or rewards[1] < expected[1][1] - 1
    assert not truncated.any()
    assert not infos["is_success"].any()
    assert np.isfinite(seen).all()
    assert np.isfinite(rewards).all()
    for got, wanted in zip((seen, rewards), expected, strict=False):
        np.testing.assert_array_equal(got[[0, 2]], wanted[[0, 2]])
    fail(envs, 1)  # whose episode has ended
    with warnings.catch_warnings(action="error"):
        assert not envs.step(action)[2].any()


def test_without_autoreset_a_step_after_the_end_is_refused(opened):
    envs = opened(ours(autoreset_mode="Disabled", max_episode_steps=1))
    envs.reset(seed=0)
    envs.step(actions()[0])
    for mask in ([True, True, False], [False, False, True]):
        check_stopped(envs)
        envs.reset(options={"reset_mask": np.array(mask)})
    envs.step(actions()[0])


@pytest.mark.parametrize("make", [partial(HandVectorEnv, Grasp()), ours], ids=["class", "id"])
@pytest.mark.parametrize(
    "options",
    [
        {"obs": "nonsense"},
        {"autoreset_mode": "nonsense"},
        {"grasp": "nonsense"},
        {"nonsense": 1},
        {"num_envs": 0},
        {"num_envs": 2.5},
        {"num_envs": True},
        {"max_episode_steps": 0},
        {"max_episode_steps": 2.5},
        {"max_episode_steps": np.nan},
        {"max_episode_steps": "5"},
        {"max_episode_steps": -1, "engine": "pybullet"},
        {"transmit": None},
    ],
    ids=str,
)
def test_a_wrong_option_is_named_at_once(make, options):
    with pytest.raises(
        (ValueError, LookupError, TypeError),
        match=r"nonsense|options (grasp|transmit)|(num_envs|max_episode_steps) = (0|2\.5|True|nan|'5'|-1) must be a whole number",
    ):
        make(**{"num_envs": 2} | options)


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda envs: envs.step(np.zeros((2, 6))), ShapeError, r"\(3, 6\), not \(2, 6\)"),
        (lambda envs: envs.step(np.zeros((3, 5))), ShapeError, r"\(..., 6\), not \(3, 5\)"),
        (lambda envs: envs.step(None), ShapeError, "array of numbers|must have shape"),
        (lambda envs: envs.reset(seed=[1, 2]), ParameterError, "2 seeds were given for 3"),
        *(
            (partial(HandVectorEnv.reset, seed=seed), ParameterError, f"seed {named} must be")
            for seed, named in (
                (1.5, r"1\.5"),
                ([0, 1.7, 2], r"1\.7"),
                ([3, 4, -1], "-1"),
                (-2, "-2"),
                ("abc", "'abc'"),
            )
        ),
        (
            lambda envs: envs.reset(options={"reset_mask": np.array([True])}),
            ParameterError,
            "reset_mask",
        ),
        (
            lambda envs: envs.reset(options={"reset_mask": np.zeros(3, bool)}),
            ParameterError,
            "reset_mask",
        ),
        (lambda envs: envs.reset(options={"reset_mask": np.ones(3)}), ParameterError, "reset_mask"),
    ],
)
def test_what_has_not_an_entry_for_each_environment_is_refused(envs, call, error, message):
    with pytest.raises(ParameterError, match="no episode is running yet"):
        envs.reset(options={"reset_mask": np.array([True, False, False])})
    envs.reset(seed=0)
    with pytest.raises(error, match=message):
        call(envs)
    envs.reset(seed=0)
    envs.step(actions()[0])


def test_a_batch_takes_a_setup_for_each_and_one_for_all(envs):
    """That the episodes are those of single environments is a test of Stable-Baselines3's."""
    setups = [replace(EASY, yaw=0.1 * place) for place in range(3)]
    envs.reset(options={"setup": setups[2]})
    mask = np.array([False, True, False])
    envs.reset(options={"setup": setups, "reset_mask": mask})
    assert [setup.yaw for setup in envs.episodes.setups] == [0.2, 0.1, 0.2]
    for wrong, told in (([], "2 setups were given for 3"), ([None], "be a SceneSetup, not None")):
        with pytest.raises(ParameterError, match=told):
            envs.reset(options={"setup": [*setups[:2], *wrong]})


# make_vec
# ------------------------------------------------------------------------------------------------------------


@pytest.mark.pybullet
@pytest.mark.parametrize(
    "name", [GRASP, *(pytest.param(name, marks=pytest.mark.slow) for name in IDS if name != GRASP)]
)
def test_make_vec_on_pybullet_makes_gymnasiums_processes_with_the_same_episodes(name, opened):
    options = {
        "engine": "pybullet",
        "max_episode_steps": 3,
        "reward": "sparse",
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }
    made = opened(ours(f"hpac_gym:{name}", 2, **options))
    its = opened(gymnasiums(name, 2, **options))
    assert type(made) is AsyncVectorEnv
    assert made.spec.id == name
    assert made.metadata == its.metadata
    assert_same(made.reset(seed=5)[0], its.reset(seed=5)[0])
    for action in actions(2, 5, size=made.single_action_space.shape[0]):
        assert_same(made.step(action)[:4], its.step(action)[:4])


@pytest.mark.parametrize("options", [{}, {"max_episode_steps": None}])
def test_make_vec_makes_one_vector_environment_with_the_limit_of_the_id(options, opened):
    with_limit = opened(ours(POSTURE, 2, **options))
    assert type(with_limit) is HandVectorEnv
    with_limit.reset(seed=0)
    for _ in range(40):
        *_, truncated, _ = with_limit.step(actions(2)[0])
    assert truncated.all()


@pytest.mark.pybullet
def test_the_processes_end_with_their_parent():
    script = (
        "import os, signal, gymnasium\n"
        "if __name__ == '__main__':\n"
        "    envs = gymnasium.make_vec('hpac_gym:HPAC-Grasp-v0', num_envs=1, engine='pybullet')\n"
        "    envs.reset(seed=0)\n"
        "    print(*[process.pid for process in envs.processes], flush=True)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = python("-c", script)
    processes = [int(word) for word in done.stdout.split()]
    assert len(processes) == 1, done.stderr
    assert done.returncode == -signal.SIGKILL
    wait_for_the_end(processes)
