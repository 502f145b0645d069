"""The gate that every environment passes, with every option: checkers, fingerprints, long random
runs, misuse.
"""

import json
import os
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import product
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from hpac_gym.envs import GRASPS
from hpac_gym.envs.randomization import Randomization
from hpac_gym.errors import EpisodeError, ShapeError, WorkspaceError
from hpac_gym.model import HPAC, SERVOS
from hpac_gym.physics.simulation import ENGINES, is_installed
from hpac_gym.registration import GRASP, GRASP_ANY, GRASP_TYPE, IDS, PICK_PLACE, POSTURE
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grip import Grip
from hpac_gym.tasks.posture import PostureConfig
from hpac_gym.tasks.task import CONTROL_HZ
from tests.envs.fingerprints import (
    BATCHES,
    BY_NAME,
    CASES,
    MUJOCO,
    PRIVILEGED,
    TOUCHED_STEPS,
    Case,
    differences,
    digest,
    ends,
    kept,
    most_flips,
    restless,
    whole,
)
from tests.processes import python


def marked(
    values: Iterable[Any], *marks: tuple[pytest.MarkDecorator, Callable[[Any], bool]]
) -> list[Any]:
    """Parameters of a test, each with the markers whose condition it meets."""
    return [
        pytest.param(value, marks=[mark for mark, where in marks if where(value)])
        for value in values
    ]


PYBULLET = pytest.mark.pybullet, lambda case: not case.on_mujoco
"""The other cases hold where there is no PyBullet."""


CHECKED = [
    *((name, {}) for name in IDS),
    *(
        (
            name,
            {
                "obs": "privileged",
                "reward": "sparse",
                "randomize": Randomization(servo_lag=(0.05, 0.15)),
            },
        )
        for name in IDS
    ),
    *(
        pytest.param(
            name,
            {"obs": "image", "render_mode": "rgb_array"},
            marks=[] if name == GRASP else pytest.mark.slow,
        )
        for name in IDS
    ),
]
PLAIN = [
    *(next(case for case in CASES if case.id == name) for name in IDS),
    *(
        case
        for case in CASES
        if case.on_mujoco and "privileged" in case.name and "grasp" not in case.options
    ),
]
"""The default case of every id, and the privileged one on MuJoCo."""

STOP_GIVES = 0.4
"""Largest momentary overshoot of a joint's stop, by a digit that snaps free of another one [rad];
20 rad/s are 0.17 a step.
"""

every_id = pytest.mark.parametrize("name", IDS)


@pytest.fixture
def env(name):
    with gymnasium.make(name) as made:
        yield made


def test_ids_are_the_registered_ones():
    assert {name for name in gymnasium.registry if name.startswith("HPAC-")} == set(IDS)


@pytest.mark.parametrize(("name", "options"), CHECKED)
def test_the_checkers_of_gymnasium_and_of_stable_baselines3_pass(name, options):
    # Here and not above: it loads PyTorch, which the pass with another rounding does not need.
    from stable_baselines3.common.env_checker import check_env as sb3_check_env

    with gymnasium.make(name, **options) as env:
        check_env(env.unwrapped, skip_render_check="render_mode" not in options)
        sb3_check_env(env.unwrapped)
        assert env.action_space.shape == (2 * len(SERVOS) if name == GRASP_TYPE else len(SERVOS),)


# Fingerprints ------------------------------------------------------------------------------


def rounded_otherwise_too(case: Case) -> bool:
    """Whether the pass with another rounding plays a case: no pictures, and no variants, which
    differ in numbers alone.
    """
    return "variant" not in case.options and case.options.get("obs") != "image"


def is_shown_by_others(case: Case) -> bool:
    """Whether the quick pass has a case much like it: another picture, another variant of a named
    grasp, or all randomizations at once.
    """
    if case.options.get("obs") == "image":
        return case.id not in (GRASP, POSTURE)
    variants = list(GRASPS[case.options["grasp"]].held_out) if "variant" in case.options else []
    return case.options.get("variant") in variants[1:] or case.options.get("randomize") in (
        "hand",
        "link",
    )


@pytest.mark.parametrize(
    "case",
    marked(
        CASES,
        (pytest.mark.processor, rounded_otherwise_too),
        (pytest.mark.slow, is_shown_by_others),
        PYBULLET,
    ),
    ids=lambda case: case.name,
)
def test_physics_reward_and_observation_are_those_of_the_version_number(case):
    """If this fails on purpose: raise -v, then run `python -m tests.envs.fingerprints --write`."""
    assert differences(case) == []


# With another rounding: not the postures, which touch nothing, nor what has the contacts of
# HPAC-Grasp-v0. In the quick pass PyBullet has the episodes that are played soon.
@pytest.mark.parametrize(
    "name",
    marked(
        BATCHES,
        (pytest.mark.processor, lambda name: name.startswith("HPAC-Grasp")),
        (pytest.mark.slow, lambda name: name in (GRASP_ANY, PICK_PLACE, POSTURE, "named grasps")),
        (pytest.mark.pybullet, lambda name: not BATCHES[name][0].on_mujoco),
    ),
)
def test_as_many_episodes_end_as_they_did(name):
    """Episodes that ended otherwise are counted, since rounding may turn a few; see
    `most_flips`.
    """
    now = np.array(ends(BATCHES[name]))
    then = np.array(kept()[f"ends/{name}"])
    assert now.shape == then.shape
    assert np.count_nonzero(np.any(now != then, axis=1)) <= most_flips(len(then))


def test_every_fingerprint_in_the_file_is_compared():
    """Every case compares free motion or a story, and of the touches of single spheres and boxes
    none is left out.
    """
    assert set(kept()) == {*BY_NAME, *(f"ends/{name}" for name in BATCHES)}
    assert len(BY_NAME) == len(CASES)
    rows = [row for name in BY_NAME for row in kept()[name]]
    assert all(row["free"]["rows"] >= 3 for row in rows)
    assert all(row["touched"]["rows"] == TOUCHED_STEPS for row in rows if "touched" in row)
    assert sum("touched" in row for row in rows) > 40


FOLLOW = Grip.follow


def unforgiving(grip: Grip, *given: Any) -> None:
    """`Grip.follow` that forgives no step without contact."""
    FOLLOW(grip, *given)
    grip._touched = np.zeros_like(grip._touched)


@pytest.mark.pybullet
@pytest.mark.parametrize(
    ("name", "number", "value"),
    [
        ("HPAC-Grasp-v0/privileged/held", "tasks.grip.CONE_EDGES", 4),
        ("HPAC-Grasp-v0", "tasks.terms.LENGTH_UNIT", 0.051),
        ("HPAC-Grasp-v0/nominal/privileged", "tasks.privileged.FORCE_UNIT", 10.1),
        ("HPAC-Grasp-v0/nominal/privileged", "tasks.privileged.SPEED_UNIT", 10.1),
        ("HPAC-Grasp-v0/image", "envs.observations.IMAGE_SIZE", 83),
        ("HPAC-Grasp-v0/large_sphere/privileged", "physics.pybullet.objects.SPIN_DECAY", 5.0),
        ("HPAC-Grasp-v0/privileged/missed", "tasks.grip.Grip.follow", unforgiving),
        ("HPAC-Grasp-v0/privileged/slips", "tasks.grip.MAX_SLIP", 0.022),
        ("HPAC-PickPlace-v0/privileged/jams", "physics.pybullet.hand.WRIST_EFFORT", 150.0),
        (
            "HPAC-Posture-v1/sparse/nominal",
            "tasks.posture.PostureConfig.__init__.__defaults__",
            (PostureConfig().duration, 0.06),
        ),
        ("HPAC-Posture-v1/privileged/flicked", "physics.pybullet.hand.MAX_JOINT_SPEED", 25.0),
    ],
)
def test_a_small_change_of_a_number_changes_the_fingerprint(monkeypatch, name, number, value):
    monkeypatch.setattr(f"hpac_gym.{number}", value)
    assert differences(BY_NAME[name])


FAULTS = {
    "friction": {"randomize": Randomization(skin_friction=(0.97, 0.97))},
    "mass": {"randomize": Randomization(object_mass=(0.97, 0.97))},
    "tendons": {"randomize": Randomization(tendon_stiffness=(0.98, 0.98))},
    "lag": {"randomize": Randomization(servo_lag=(0.005, 0.005))},
    "camera": {"noise": CameraNoise(position=0.0016)},
    "worse camera": {"noise": CameraNoise(position=0.003)},
    "reward": {"reward": "sparse"},
}


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        *(
            pytest.param("HPAC-Grasp-v0", fault, marks=pytest.mark.pybullet)
            for fault in ("friction", "mass", "tendons", "lag", "camera", "reward")
        ),
        *(
            ("HPAC-Grasp-v0/mujoco/privileged", fault)
            for fault in ("tendons", "lag", "worse camera", "reward")
        ),
    ],
)
def test_a_small_change_of_physics_reward_or_observation_changes_the_fingerprint(name, fault):
    """On MuJoCo friction and mass act from the touch on: the next test has friction."""
    assert differences(BY_NAME[name], **FAULTS[fault])


@pytest.mark.parametrize(
    ("name", "fault"),
    [
        pytest.param("HPAC-Grasp-v0", {"skin_friction": (0.5, 0.5)}, marks=pytest.mark.pybullet),
        ("HPAC-Grasp-v0 on MuJoCo", {"skin_friction": (0.5, 0.5)}),
    ],
)
def test_a_large_change_of_physics_ends_many_episodes_otherwise(name, fault):
    """Among the first twenty."""
    first = [replace(case, seeds=case.seeds[:20]) for case in BATCHES[name]]
    now = np.array(ends(first, randomize=fault))
    then = np.array(kept()[f"ends/{name}"])[: len(now)]
    assert np.count_nonzero(np.any(now != then, axis=1)) > most_flips(len(then))


@pytest.fixture(scope="module")
def printed():
    """The hashes of another process, which prints nothing else."""
    names = [case.name for case in PLAIN if case.on_mujoco or is_installed("pybullet")]
    done = python("-m", "tests.envs.fingerprints", *names)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", marked(PLAIN, PYBULLET), ids=lambda case: case.name)
def test_same_seed_same_trajectory_to_the_bit(case, printed):
    """After another episode, in a fresh environment that can render too, and in a subprocess."""
    with case.make() as env:
        env.reset(seed=99)
        env.step(env.action_space.sample())
        assert digest(env, case) == printed[case.name]
    with case.make(render_mode="rgb_array") as fresh:
        assert digest(fresh, case) == printed[case.name]


@every_id
def test_a_randomized_episode_is_its_seed_s_too_and_another_seed_s_another_one(name):
    case = Case(name, MUJOCO | PRIVILEGED | {"randomize": "full"}, restless)
    with case.make() as env:
        first = case.play(env, 5, 8).bits()
        (begun,) = env.unwrapped.episodes.setups
        assert case.play(env, 6, 8).bits() != first
        assert env.unwrapped.episodes.setups[0].hand_settings != begun.hand_settings
        assert case.play(env, 5, 8).bits() == first


# Long random runs -----------------------------------------------------------------------------


def memory() -> int:
    """Resident memory of this process [bytes]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


LOST = {(GRASP_TYPE, "pybullet"): 0.1e6}
"""Most that an episode loses for good: each of this id loads a hand, whose wrist is another, and
PyBullet keeps the direct solver of a world that it has reset, measured 0.08 MB [bytes].
"""
THROWN = {"pybullet": 1 / 500, "mujoco": 0.0}
"""Largest share of episodes in which an object leaves the scene: PyBullet's direct solver throws one
in about a thousand, of those that random actions squeeze.
"""


@pytest.mark.parametrize(
    ("steps", "growth"), [(90, 8e6), pytest.param(350_000, 30e6, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("engine", ENGINES)
@every_id
def test_random_actions_break_nothing(name, engine, steps, growth):
    """Each held for some steps, in the hardest randomization; no NaN, no escape but for what is
    `THROWN`, memory grows by less [bytes], but for what is `LOST`.
    """
    hardest = Randomization(
        tendon_stiffness=(0.5, 1.3),
        slack=(0.0, 3e-3),
        skin_friction=(0.3, 2.0),
        object_mass=(0.2, 5.0),
        servo_lag=(0.0, 0.15),
        dropped_frames=(0.0, 0.5),
    )
    rng = np.random.default_rng(1)
    with gymnasium.make(name, engine=engine, obs="privileged", randomize=hardest) as env:
        for seed in reversed(range(8)):  # with the wrists of an id, for which hands are loaded
            env.reset(seed=seed)
        episodes = 1
        thrown = set()
        files = len(os.listdir("/proc/self/fd"))
        for step in range(steps):
            if step % 5 == 0:
                action = rng.choice([-1.0, 1.0], 6) if rng.random() < 0.3 else rng.uniform(-1, 1, 6)
            observation, reward, terminated, truncated, _ = env.step(
                whole(env, action.astype(np.float32))
            )
            assert np.isfinite(reward)
            assert env.observation_space.contains(observation)
            if step % 10 == 0:
                state = env.unwrapped.state
                # A hand that arrives in the object is pushed out, and its episode fails.
                arriving = name == GRASP_TYPE and (terminated or state.time[0] < 1.5 / CONTROL_HZ)
                if not arriving:
                    assert np.all(state.joint_pos > HPAC.joint_min - STOP_GIVES)
                    assert np.all(state.joint_pos < HPAC.joint_max + STOP_GIVES)
                    assert np.all(np.abs(state.joint_vel) < 200)
                    if np.any(np.abs(state.object_pos) > 3.0):
                        thrown.add(episodes)
            if terminated or truncated:
                env.reset()
                episodes += 1
            if step == steps // 3:
                settled = memory()
                before = episodes
        assert len(thrown) <= THROWN[engine] * episodes
        lost = LOST.get((name, engine), 0.0) * (episodes - before)
        assert memory() - settled - lost < growth
        assert len(os.listdir("/proc/self/fd")) == files


# Misuse ---------------------------------------------------------------------------------------


NO_ACTIONS = [
    np.zeros(5),
    np.zeros((2, 6)),
    np.full(6, 0.5 + 0.5j),
    np.array(["0.5"] * 6),
    ["0.5"] * 6,
    "open",
    None,
]


@every_id
def test_a_bad_action_raises_and_moves_nothing(name, env):
    """But for what float32 rounds past a bound, which is the bound."""
    bare = env.unwrapped
    bare.reset(seed=2)  # a grasp type whose place is clear of the open hand
    still = whole(bare, np.full(6, -1.0, np.float32))
    labels = (*SERVOS, *bare.task.wrist_actions)
    bare.step(still)
    before = bare.episodes.simulation.state().joint_pos
    for column, bad in product((2, -1), (np.nan, np.inf, 1.5, 1.00001)):
        action = still.astype(float)
        action[column] = bad
        told = f"{labels[column]} = {bad:g} .*ClipAction" if bad > 0 else f"{labels[column]} = nan"
        with pytest.raises(WorkspaceError, match=told):
            bare.step(action)
    for action in NO_ACTIONS:
        with pytest.raises(ShapeError, match="must"):
            bare.step(action)
    np.testing.assert_array_equal(bare.episodes.simulation.state().joint_pos, before)
    bare.step(np.nextafter(np.ones(env.action_space.shape, np.float32), np.float32(2)))


@every_id
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_calls_out_of_order_say_so(name, make):
    bare = make(name, render_mode="rgb_array").unwrapped
    for call in (lambda: bare.step(np.zeros(6)), bare.render):
        with pytest.raises(EpisodeError, match="reset"):
            call()
    bare.reset(seed=0)
    bare.close()
    bare.close()
    for call in (lambda: bare.step(np.zeros(6)), bare.reset, bare.render):
        with pytest.raises(EpisodeError, match="closed"):
            call()


@every_id
def test_info_can_be_logged_and_the_reward_is_the_sum_of_its_named_terms(name, env):
    env.reset(seed=4)
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = whole(env, rng.uniform(-1, 1, 6).astype(np.float32))
        _, reward, terminated, _, info = env.step(action)
        assert json.loads(json.dumps(info)) == info
        assert isinstance(info["is_success"], bool)
        if name != POSTURE:
            names = [term.name for term in env.unwrapped.task.reward_terms]
            assert list(info["reward_terms"]) == names
            assert reward == pytest.approx(sum(info["reward_terms"].values()))
        if terminated:
            break
