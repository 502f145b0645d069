"""The gate that every environment passes, with every option: checkers, fingerprints, long random runs, misuse."""

import json
import os
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

from hpac_gym.envs import GRASPS
from hpac_gym.envs.errors import EpisodeError
from hpac_gym.envs.observation import CameraNoise
from hpac_gym.envs.randomization import PRESETS, Randomization
from hpac_gym.errors import ShapeError, WorkspaceError
from hpac_gym.model import HPAC, SERVOS
from tests.envs.fingerprints import (
    ABSOLUTE,
    BY_NAME,
    CASES,
    FILE,
    IDS,
    RELATIVE,
    Case,
    fingerprint,
    flat,
    kept,
    same,
)

OPTIONS = [
    {},
    {"reward": "sparse"},
    {"obs": "privileged"},
    {"obs": "image"},
    *({"randomize": name} for name in PRESETS),
    {"obs": "privileged", "reward": "sparse", "randomize": Randomization(servo_lag=(0.05, 0.15))},
]
RANDOM_STEPS = 10_000
"""Of each id in the default run; `make test-all` makes 350,000 of each."""

PLAIN = [case for case in CASES if set(case.options) <= {"grasp"} and not case.about]
"""What an id gives by default, and every named grasp."""

STOP_GIVES = 0.4
"""How far a digit that snaps free of another one may run into its stop, for a moment [rad]; 20 rad/s are 0.17 a step."""

every_id = pytest.mark.parametrize("name", IDS)
every_option = pytest.mark.parametrize("options", OPTIONS, ids=lambda options: "-".join(map(str, options.values()))[:30])


@pytest.fixture
def env(name):
    with gymnasium.make(name) as made:
        yield made


def sim_hand(env: gymnasium.Env):
    """The simulated hand below an environment."""
    bare = env.unwrapped
    return bare.scene.hand if hasattr(bare, "scene") else bare._body


def test_ids_are_the_registered_ones():
    assert {"HPAC-Grasp-v0", "HPAC-PickPlace-v0", "HPAC-Posture-v0"} <= set(IDS)


@every_id
@every_option
def test_the_checkers_of_gymnasium_and_of_stable_baselines3_pass(name, options):
    with gymnasium.make(name, **options) as env:
        check_env(env.unwrapped, skip_render_check=True)
        sb3_check_env(env.unwrapped)
        assert env.action_space.shape == (len(SERVOS),)


@pytest.mark.parametrize("grasp", GRASPS)
def test_the_checkers_pass_on_every_named_grasp(grasp):
    with gymnasium.make("HPAC-Grasp-v0", grasp=grasp) as env:
        check_env(env.unwrapped, skip_render_check=True)
        sb3_check_env(env.unwrapped)


@every_id
def test_gymnasium_s_checker_passes_with_rendering(name):
    with gymnasium.make(name, render_mode="rgb_array") as env:
        check_env(env.unwrapped)
        env.reset(seed=0)
        assert env.render().shape == (360, 480, 3)


# Fingerprints ------------------------------------------------------------------------------


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_physics_reward_and_observation_are_those_of_the_version_number(case):
    """If this fails on purpose: raise -v, then run `python tests/envs/fingerprints.py --write`."""
    with case.make() as env:
        found = fingerprint(env, case)["episodes"]
    for then, now in zip(kept()[case.name]["episodes"], found, strict=True):
        for name, values in now.items():
            message = f"{case.name}, seed {then['seed']}: {name} is not what it was"
            np.testing.assert_allclose(values, then[name], RELATIVE, ABSOLUTE, err_msg=message)


def test_every_fingerprint_in_the_file_is_compared():
    assert set(kept()) == set(BY_NAME)
    assert len(BY_NAME) == len(CASES)


def changed(case: Case, **fault: Any) -> bool:
    """Whether a case's fingerprint is another one now, or with a fault."""
    with case.make(**fault) as env:
        found = fingerprint(env, case)["episodes"]
    return not all(map(same, kept()[case.name]["episodes"], found))


@pytest.mark.parametrize(
    ("name", "number", "value"),
    [
        ("HPAC-Grasp-v0", "hpac_gym.envs.quality.CONE_EDGES", 4),
        ("HPAC-Grasp-v0", "hpac_gym.envs.observation.LENGTH_UNIT", 0.051),
        ("HPAC-Grasp-v0/nominal/privileged", "hpac_gym.envs.views.FORCE_UNIT", 10.1),
        ("HPAC-Grasp-v0/nominal/privileged", "hpac_gym.envs.views.SPEED_UNIT", 10.1),
        ("HPAC-Grasp-v0/image", "hpac_gym.envs.views.IMAGE_SIZE", 83),
        ("HPAC-Posture-v0/nominal/privileged", "hpac_gym.envs.posture.FORCE_UNIT", 10.1),
        ("HPAC-Posture-v0/image", "hpac_gym.envs.posture.IMAGE_SIZE", 83),
        ("HPAC-Posture-v0/sparse", "hpac_gym.envs.posture.TOLERANCE", 0.06),
        *((case.name, *case.reacts) for case in CASES if case.reacts),
    ],
)
def test_a_small_change_of_a_number_changes_the_fingerprint(monkeypatch, name, number, value):
    monkeypatch.setattr(number, value)
    assert changed(BY_NAME[name])


@pytest.mark.parametrize(
    "fault",
    [
        {"randomize": Randomization(skin_friction=(0.97, 0.97))},
        {"randomize": Randomization(tendon_stiffness=(0.98, 0.98))},
        {"randomize": Randomization(servo_lag=(0.005, 0.005))},
        {"noise": CameraNoise(position=0.0016)},
        {"reward": "sparse"},
    ],
    ids=["friction", "tendons", "lag", "camera", "reward"],
)
def test_a_small_change_of_physics_reward_or_observation_changes_the_fingerprint(fault):
    assert changed(BY_NAME["HPAC-Grasp-v0"], **fault)


@pytest.fixture(scope="module")
def printed():
    """The fingerprints of another process, which prints nothing else."""
    script = str(FILE.with_suffix(".py"))
    paths = os.pathsep.join(path for path in (str(FILE.parents[2]), os.environ.get("PYTHONPATH")) if path)
    done = subprocess.run(
        [sys.executable, script, *(case.name for case in PLAIN)],
        capture_output=True, text=True, check=True, timeout=300, env=os.environ | {"PYTHONPATH": paths},
    )  # fmt: skip
    return json.loads(done.stdout)


@pytest.mark.parametrize("case", PLAIN, ids=lambda case: case.name)
def test_same_seed_same_trajectory_to_the_bit(case, printed):
    """On re-reset, in a fresh environment that can render too, and in a subprocess."""
    with case.make() as env:
        first = fingerprint(env, case)
        env.reset(seed=99)
        env.step(env.action_space.sample())
        assert fingerprint(env, case) == first
    with case.make(render_mode="rgb_array") as fresh:
        assert fingerprint(fresh, case) == first
    assert printed[case.name] == first


@every_id
def test_another_seed_is_another_episode(name, env):
    first, second = (flat(env.reset(seed=seed)[0]) for seed in (0, 1))
    assert not np.array_equal(first, second)


@every_id
@pytest.mark.parametrize("place", [0, 2])
def test_any_place_in_a_vector_env_gives_the_same_trajectory(name, place, env):
    envs = gymnasium.make_vec(name, num_envs=3, vectorization_mode="sync")
    seeds = [50, 51, 52]
    seeds[place] = 9
    together, _ = envs.reset(seed=seeds)
    alone, _ = env.reset(seed=9)
    rng = np.random.default_rng(0)
    for _ in range(12):
        if isinstance(alone, dict):
            together = {key: rows[place] for key, rows in together.items()}
            np.testing.assert_array_equal(flat(together), flat(alone))
        else:
            np.testing.assert_array_equal(together[place], alone)
        actions = rng.uniform(-1, 1, (3, 6)).astype(np.float32)
        together, *_ = envs.step(actions)
        alone, _, terminated, *_ = env.step(actions[place])
        if terminated:
            break
    envs.close()


@every_id
@pytest.mark.parametrize("preset", PRESETS)
def test_a_randomized_episode_is_its_seed_s_too(name, preset):
    def trajectory(env, seed):
        rows = [flat(env.reset(seed=seed)[0])]
        for step in range(8):
            observation, *_ = env.step(np.full(6, np.sin(step), np.float32))
            rows.append(flat(observation))
        return np.array(rows)

    with gymnasium.make(name, randomize=preset, obs="privileged") as env, gymnasium.make(name, randomize=preset) as other:
        first = trajectory(env, 5)
        trajectory(env, 6)
        elsewhere = sim_hand(env).settings
        np.testing.assert_array_equal(trajectory(env, 5), first)
        other.reset(seed=5)
        assert sim_hand(env).settings == sim_hand(other).settings
        assert sim_hand(env).settings != elsewhere or preset == "nominal"


# Long random runs -----------------------------------------------------------------------------


def memory() -> int:
    """Resident memory of this process [bytes]."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGESIZE")


def run_randomly(name: str, steps: int) -> None:
    """Random actions, each held for some steps, in the hardest randomization; no NaN, no leak, no escape."""
    hardest = Randomization(
        tendon_stiffness=(0.5, 1.3), slack=(0.0, 3e-3), skin_friction=(0.3, 2.0), object_mass=(0.2, 5.0),
        servo_lag=(0.0, 0.15), dropped_frames=(0.0, 0.5),
    )  # fmt: skip
    rng = np.random.default_rng(1)
    with gymnasium.make(name, obs="privileged", randomize=hardest) as env:
        env.reset(seed=0)
        settled, files = None, len(os.listdir("/proc/self/fd"))
        for step in range(steps):
            if step % 5 == 0:
                action = rng.choice([-1.0, 1.0], 6) if rng.random() < 0.3 else rng.uniform(-1, 1, 6)
            observation, reward, terminated, truncated, _ = env.step(action.astype(np.float32))
            assert np.isfinite(reward)
            assert env.observation_space.contains(observation)
            if step % 10 == 0:
                joint_pos, joint_vel = sim_hand(env).joint_state()
                assert np.all(joint_pos > HPAC.joint_min - STOP_GIVES)
                assert np.all(joint_pos < HPAC.joint_max + STOP_GIVES)
                assert np.all(np.abs(joint_vel) < 200)
                if hasattr(env.unwrapped, "scene"):
                    assert np.all(np.abs(env.unwrapped.scene.object.pose()[0]) < 3.0)
            if terminated or truncated:
                env.reset()
            if step == steps // 3:
                settled = memory()
        assert memory() - settled < 30e6
        assert len(os.listdir("/proc/self/fd")) == files


@every_id
def test_random_actions_break_nothing(name):
    run_randomly(name, RANDOM_STEPS)


@pytest.mark.slow
@every_id
def test_a_million_random_actions_in_all_break_nothing(name):
    run_randomly(name, 350_000)


# Misuse ---------------------------------------------------------------------------------------


@every_id
@pytest.mark.parametrize(
    ("action", "error"),
    [
        (np.array([0, 0, np.nan, 0, 0, 0]), WorkspaceError),
        (np.array([0, 0, np.inf, 0, 0, 0]), WorkspaceError),
        (np.array([0, 0, 1.5, 0, 0, 0]), WorkspaceError),
        (np.zeros(5), ShapeError),
        (np.zeros((2, 6)), ShapeError),
    ],
)
def test_a_bad_action_raises_and_moves_nothing(name, env, action, error):
    bare = env.unwrapped
    bare.reset(seed=0)
    bare.step(np.zeros(6, np.float32))
    before = sim_hand(env).joint_pos
    with pytest.raises(error, match=SERVOS[2] if error is WorkspaceError else "shape"):
        bare.step(action)
    np.testing.assert_array_equal(sim_hand(env).joint_pos, before)
    bare.step(np.zeros(6, np.float32))


@every_id
def test_calls_out_of_order_say_so(name):
    bare = gymnasium.make(name, render_mode="rgb_array").unwrapped
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
def test_info_can_be_logged(name, env):
    env.reset(seed=0)
    *_, info = env.step(np.zeros(6, np.float32))
    assert json.loads(json.dumps(info)) == info
    assert isinstance(info["is_success"], bool)
