"""What `gymnasium.make_vec` makes: single environments side by side, to the bit, in processes that leave nothing behind."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from hpac_gym.envs.errors import EpisodeError, WorkerError
from hpac_gym.envs.vector import GroupedVectorEnv
from hpac_gym.envs.vector_workers import shares
from hpac_gym.errors import ParameterError, ShapeError, WorkspaceError
from tests.envs.odd_env import OddEnv

IDS = ("HPAC-Grasp-v0", "HPAC-PickPlace-v0", "HPAC-Posture-v0")
GRASP = IDS[0]


def grouped(name: str = GRASP, num_envs: int = 3, **options) -> GroupedVectorEnv:
    """By way of Gymnasium, in two processes of which one has more to do."""
    return gymnasium.make_vec(
        f"hpac_gym:{name}", num_envs=num_envs, vectorization_mode="vector_entry_point", workers=2, **options
    )


def actions(num_envs: int = 3, steps: int = 8) -> np.ndarray:
    return np.random.default_rng(0).uniform(-1, 1, (steps, num_envs, 6)).astype(np.float32)


def assert_same(one, other) -> None:
    """Equal to the bit, dtypes too, through dictionaries, tuples and arrays of objects."""
    assert type(one) is type(other)
    if isinstance(one, dict):
        assert set(one) == set(other)
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, tuple | list):
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)
    elif isinstance(one, np.ndarray) and one.dtype == object:
        assert_same(list(one), list(other))
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


def place_of(observation, place):
    """One environment's part of a batch."""
    return {k: v[place] for k, v in observation.items()} if isinstance(observation, dict) else observation[place]


def assert_gone(processes: list[int]) -> None:
    for process in processes:
        with pytest.raises(ProcessLookupError):
            os.kill(process, 0)


def running(process: int) -> bool:
    """Whether there is such a process; one that only waits to be buried is none."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.fixture
def odd():
    envs = GroupedVectorEnv(OddEnv, 3, workers=2)
    envs.reset(seed=0)
    yield envs
    envs.close()


@pytest.mark.parametrize("name", IDS)
def test_every_place_has_the_trajectory_of_a_single_environment(name):
    envs, env = grouped(name), gymnasium.make(name)
    batches = [envs.reset(seed=7)[0]]
    rewards = []
    for action in actions():
        observation, reward, *_ = envs.step(action)
        assert observation in envs.observation_space
        batches.append(observation)
        rewards.append(reward)
    envs.close()
    for place in range(3):
        assert_same(place_of(batches[0], place), env.reset(seed=7 + place)[0])
        for step, action in enumerate(actions()):
            observation, reward, *_ = env.step(action[place])
            assert_same(place_of(batches[step + 1], place), observation)
            assert rewards[step][place] == reward
    env.close()


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name)
@pytest.mark.parametrize(
    ("name", "options"),
    [(GRASP, {}), ("HPAC-Posture-v0", {}), (GRASP, {"obs": "image"})],
    ids=["vector", "goals", "image"],
)
def test_everything_is_as_in_gymnasiums_own_over_an_episodes_end(name, options, mode):
    options = options | {"max_episode_steps": 3}
    ours = grouped(name, autoreset_mode=mode, **options)
    its = gymnasium.make_vec(name, num_envs=3, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options)
    assert ours.metadata == its.metadata
    assert (ours.observation_space, ours.action_space) == (its.observation_space, its.action_space)
    assert_same(ours.reset(seed=5), its.reset(seed=5))
    for action in actions():
        seen, expected = ours.step(action), its.step(action)
        assert_same(seen, expected)
        over = seen[2] | seen[3]
        if mode is AutoresetMode.DISABLED and over.any():
            for mask in (over & [True, False, False], over & [False, True, True]):
                assert_same(ours.reset(options={"reset_mask": mask}), its.reset(options={"reset_mask": mask}))
    ours.close()
    its.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP], ids=lambda mode: mode.name)
def test_an_episode_that_is_won_ends_as_in_gymnasiums_own(mode):
    ours, its = GroupedVectorEnv(OddEnv, 3, 2, mode), SyncVectorEnv([OddEnv] * 3, autoreset_mode=mode)
    assert_same(ours.reset(seed=0), its.reset(seed=0))
    for action in ([0, 0.5, 0], [0.5, 0, 0], [0, 0, 0]):
        assert_same(ours.step(np.array([action]).T), its.step(np.array([action]).T))
    ours.close()
    its.close()


def test_with_autoreset_disabled_a_step_after_the_end_is_refused():
    envs = GroupedVectorEnv(OddEnv, 3, 2, AutoresetMode.DISABLED)
    envs.reset()
    envs.step([[0], [0], [0.5]])
    with pytest.raises(EpisodeError, match="reset_mask"):
        envs.step([[0], [0], [0]])
    envs.reset(options={"reset_mask": np.array([False, False, True])})
    envs.step([[0], [0], [0]])
    envs.close()


def test_the_default_autoreset_mode_is_gymnasiums():
    ours, its = grouped(num_envs=1), gymnasium.make_vec(GRASP, num_envs=1, vectorization_mode="sync")
    assert ours.metadata == its.metadata
    assert ours.spec.id == GRASP
    assert len(ours.processes) == 1
    ours.close()
    its.close()


def test_an_action_of_double_precision_is_not_rounded():
    ours, its = grouped(), gymnasium.make_vec(GRASP, num_envs=3, vectorization_mode="sync")
    action = np.random.default_rng(1).uniform(-1, 1, (3, 6))
    for envs in (ours, its):
        envs.reset(seed=0)
    assert_same(ours.step(action), its.step(action))
    ours.close()
    its.close()


def test_what_was_returned_stays_as_it_was():
    envs = grouped()
    first = envs.reset(seed=0)[0]
    kept = first.copy()
    results = envs.step(actions()[0])[:4]
    copies = [result.copy() for result in results]
    envs.step(actions()[1])
    np.testing.assert_array_equal(first, kept)
    assert_same(list(results), copies)
    envs.close()


def test_a_mask_resets_only_what_it_marks():
    envs = grouped()
    before = envs.reset(seed=0)[0]
    mask = {"reset_mask": np.array([False, True, False])}
    after, infos = envs.reset(seed=40, options=mask)
    assert list(mask) == ["reset_mask"]
    np.testing.assert_array_equal((before != after).any(axis=1), [False, True, False])
    np.testing.assert_array_equal(infos["_is_success"], [False, True, False])
    envs.close()


def test_pictures_and_attributes_come_from_every_place():
    envs, env = grouped(render_mode="rgb_array"), gymnasium.make(GRASP, render_mode="rgb_array")
    envs.reset(seed=0)
    env.reset(seed=2)
    frames = envs.render()
    assert envs.render_mode == "rgb_array"
    assert len(frames) == 3
    np.testing.assert_array_equal(frames[2], env.render())
    assert envs.call("phase") == ("close",) * 3
    envs.close()
    env.close()


def test_an_environments_error_is_raised_as_it_is_alone_and_the_rest_goes_on():
    envs, env = grouped(), gymnasium.make(GRASP)
    env.reset(seed=0)
    bad = np.full((3, 6), 0.0)
    bad[2, 1] = np.nan
    with pytest.raises(WorkspaceError) as alone:
        env.step(bad[2])
    first = envs.reset(seed=0)[0]
    with pytest.raises(WorkspaceError) as caught:
        envs.step(bad)
    assert str(caught.value) == str(alone.value)
    assert "environment 2" in caught.value.__notes__[0]
    np.testing.assert_array_equal(envs.reset(seed=0)[0], first)
    envs.close()
    env.close()


def test_a_step_before_the_reset_says_what_a_single_environment_says():
    envs = grouped()
    with pytest.raises(gymnasium.error.ResetNeeded):
        envs.step(actions()[0])
    envs.close()


def test_an_error_that_no_pipe_carries_is_told_by_name(odd):
    with pytest.raises(RuntimeError, match="LockedError: action 2 is refused"):
        odd.step([[0], [2], [0]])
    odd.step([[0], [0], [0]])


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"obs": "nonsense"}, ParameterError),
        ({"autoreset_mode": "nonsense"}, ParameterError),
        ({"num_envs": 0}, ParameterError),
        ({"nonsense": 1}, TypeError),
    ],
)
def test_a_wrong_option_is_named_at_once(options, error):
    with pytest.raises(error, match=r"nonsense|num_envs"):
        grouped(**options)


@pytest.mark.parametrize(
    "call",
    [
        lambda envs: envs.step([[0.0]] * 2),
        lambda envs: envs.step([[0.0, 0.0]] * 3),
        lambda envs: envs.reset(seed=[1, 2]),
        lambda envs: envs.reset(options={"reset_mask": np.array([True])}),
        lambda envs: envs.reset(options={"reset_mask": np.zeros(3, bool)}),
        lambda envs: envs.reset(options={"reset_mask": np.ones(3)}),
    ],
)
def test_what_has_not_an_entry_for_each_environment_is_refused(odd, call):
    with pytest.raises(ShapeError):
        call(odd)
    odd.step([[0.0]] * 3)


def test_a_killed_worker_is_named_once_and_for_all(odd):
    processes = odd.processes
    os.kill(processes[1], signal.SIGKILL)
    for _ in range(2):
        with pytest.raises(WorkerError, match=r"worker 1, with environments 2 to 2, ended with exit code -9"):
            odd.step([[0], [0], [0]])
    odd.close()
    assert_gone(processes)


def test_closing_leaves_no_process_and_ends_every_call(odd):
    processes = odd.processes
    odd.close()
    odd.close()
    assert_gone(processes)
    for call in (odd.reset, odd.render, lambda: odd.step([[0]] * 3), lambda: odd.processes):
        with pytest.raises(EpisodeError, match="closed"):
            call()


def test_a_vector_that_nobody_holds_closes_itself():
    envs = GroupedVectorEnv(OddEnv, 2, workers=2)
    processes = envs.processes
    del envs
    assert_gone(processes)


def test_after_an_interrupted_call_there_is_only_closing(odd):
    def interrupt(*_):
        raise KeyboardInterrupt

    processes, usual = odd.processes, signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, 0.2)
    try:
        with pytest.raises(KeyboardInterrupt):
            odd.step([[1], [0], [0]])
    finally:
        signal.signal(signal.SIGALRM, usual)
    with pytest.raises(WorkerError, match="interrupted"):
        odd.step([[0], [0], [0]])
    odd.close()
    assert_gone(processes)


def test_a_worker_that_does_not_listen_is_killed(odd, monkeypatch):
    monkeypatch.setattr("hpac_gym.envs.vector_workers.CLOSE_SECONDS", 0.2)
    processes = odd.processes
    os.kill(processes[0], signal.SIGSTOP)
    odd.close()
    assert_gone(processes)


def test_workers_end_with_a_parent_that_is_killed():
    script = (
        "import os, signal\n"
        "from hpac_gym.envs.vector import GroupedVectorEnv\n"
        "from tests.envs.odd_env import OddEnv\n"
        "print(*GroupedVectorEnv(OddEnv, 2, workers=2).processes, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=600)
    processes = [int(word) for word in done.stdout.split()]
    assert len(processes) == 2, done.stderr
    deadline = time.monotonic() + 10
    while any(map(running, processes)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(running, processes))


def test_a_script_without_the_guard_is_told_of_it(tmp_path):
    script = tmp_path / "bare.py"
    script.write_text('import gymnasium\ngymnasium.make_vec("hpac_gym:HPAC-Grasp-v0", num_envs=2)\n')
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=600)
    assert done.returncode == 1
    assert "WorkerError" in done.stderr
    assert 'if __name__ == "__main__":' in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(("count", "workers"), [(1, 1), (3, 2), (8, 2), (7, 3), (5, 5)])
def test_the_shares_are_neighbours_and_even(count, workers):
    found = shares(count, workers)
    assert [place for share in found for place in share] == list(range(count))
    assert max(map(len, found)) - min(map(len, found)) <= 1
