import json
import os
import signal
import time
from importlib.util import find_spec
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from agents import reproduce
from agents.curves import draw_trials
from hpac_gym.errors import ParameterError
from hpac_gym.evaluation import evaluate as command
from hpac_gym.evaluation.environment import make_env
from hpac_gym.evaluation.episodes import run_episodes, single
from hpac_gym.evaluation.evaluate import BLOCK, evaluate, results, table
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import success_counts, wilson_interval
from hpac_gym.policies.loading import load_policy
from tests.envs.episodes import steps
from tests.options import called
from tests.processes import ROOT, children_of, started, wait_for_the_end

TINY = "tests.tiny_task:Tiny-v0"


def test_episodes_do_not_depend_on_the_number_of_workers():
    alone = evaluate(["random"], TINY, 12, workers=1)
    assert evaluate("random", TINY, 12, workers=2) == alone
    assert (
        evaluate(["random"], TINY, 5, workers=1).episodes["random"] == alone.episodes["random"][:5]
    )
    assert [episode.seed for episode in alone.episodes["random"]] == list(
        range(HELD_OUT_SEED, HELD_OUT_SEED + 12)
    )


@pytest.mark.parametrize("numbers", [{"episodes": 0}, {"episodes": 3, "workers": 0}])
def test_numbers_below_1_are_refused(numbers):
    with pytest.raises(ParameterError, match=r"(episodes|workers) = 0 must be a whole number of"):
        evaluate(["random"], TINY, **numbers)


REAL = pytest.param("HPAC-GraspAny-v1", {"objects": "real"}, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("name", "options"), [("HPAC-Grasp-v0", {}), ("HPAC-Posture-v1", {}), REAL]
)
def test_an_episode_in_a_batch_is_the_one_that_a_world_alone_has(name, options):
    env = make_env(name, engine="mujoco", **options)
    policies = [load_policy("scripted", env) for _ in range(3)]
    envs = gymnasium.make_vec(name, 3, engine="mujoco", autoreset_mode="Disabled", **options)
    seeds = [HELD_OUT_SEED + place for place in (0, 7, 1, 2)]
    together = {found.seed: found for found in results(run_episodes(envs, policies, seeds))}
    assert list(together) != seeds or name == "HPAC-Posture-v1", "they end in another order"
    for seed in seeds:
        ours = together[seed]
        assert [ours] == list(results(run_episodes(single(env), policies[:1], [seed])))
        script = env.unwrapped.task.script()
        _, rewards, *_, infos = zip(*steps(env, script, seed=seed), strict=True)
        # Step by step, since `sum` rounds otherwise from Python 3.12 on.
        assert (ours.total_reward, ours.steps) == (np.cumsum(rewards)[-1], len(rewards) - 1)
        told = (infos[-1].get(name) for name in ("is_success", "phase", "holding_force"))
        assert (ours.success, ours.phase, ours.holding_force) == tuple(told)
    assert len({episode.total_reward for episode in together.values()}) == len(seeds)
    env.close()
    envs.close()


def test_the_summary_counts_what_the_episodes_say():
    result = evaluate(["random"], TINY, 60)
    episodes = result.episodes["random"]
    wins = sum(episode.success for episode in episodes)
    numbers = result.summary()["policies"]["random"]
    assert numbers["successes"] == wins
    assert tuple(numbers["interval_95"]) == wilson_interval(wins, 60)
    assert numbers["return_mean"] == pytest.approx(
        np.mean([episode.total_reward for episode in episodes])
    )
    assert numbers["failures_by_phase"] == {"end": 60 - wins}
    assert f"| random | 60 | {wins / 60:.1%} |" in table(result.summary())


def test_a_time_limit_takes_fewer_episodes_and_says_so():
    result = evaluate(["random"], TINY, 10_000, time_limit=1e-9)
    assert len(result.episodes["random"]) == BLOCK
    assert result.summary()["policies"]["random"]["episodes"] == BLOCK


@pytest.mark.parametrize(
    ("episodes", "workers", "engine", "sizes"),
    [
        (100, 3, "mujoco", [34, 34, 32]),
        (120, 1, "mujoco", [50, 50, 20]),
        (5, 2, None, [3, 2]),
        (25, 1, None, [10, 10, 5]),
    ],
)
def test_every_worker_has_work_and_the_bar_moves_early(
    episodes, workers, engine, sizes, monkeypatch
):
    ran = []

    def run_block(names, env_id, options, seeds, normalize):
        ran.append(len(seeds))
        return [(command.Episode(seed, True, 1.0, 1, None),) for seed in seeds]

    monkeypatch.setattr(command, "shared", lambda _, jobs, count: (run_block(*job) for job in jobs))
    env_id, options = ("HPAC-Grasp-v0", {"engine": engine}) if engine else (TINY, {})
    evaluate(["random"], env_id, episodes, workers=workers, options=options)
    assert ran == sizes


def test_a_policy_is_called_as_it_was_given_and_no_phases_are_told_of_a_task_without(capsys):
    words = ["--randomize", "hand", "--episodes", "2", "--workers", "1"]
    assert called(command, "--policy", "posture", "--env", "HPAC-Posture-v1", *words) == 0
    table_of, options, *_ = capsys.readouterr().out.split("\n\n")
    assert options == "Options: randomize hand, engine mujoco, body twin."
    head, _, first, *_ = table_of.splitlines()
    assert first.startswith("| posture | 2 |")
    assert "phase" not in head
    assert "unknown" not in table_of
    assert {line.count("|") for line in table_of.splitlines()} == {6}


ENDLESS = [
    "evaluate",
    "--policy",
    "random",
    "--env",
    TINY,
    "--episodes",
    "100000",
    "--workers",
    "2",
]


@pytest.mark.parametrize("seconds", [pytest.param(0.0, marks=pytest.mark.slow), 1.0])
def test_ctrl_c_on_a_terminal_ends_an_evaluation_at_once(seconds):
    """While the workers start, and while they work."""
    with started("-m", "hpac", *ENDLESS, session=True) as running:
        workers = children_of(running, 3)  # with the tracker of their resources
        time.sleep(seconds)
        os.killpg(running.pid, signal.SIGINT)
        _, complaints = running.communicate(timeout=10)
    assert (running.returncode, complaints) == (130, "interrupted\n")
    wait_for_the_end(workers, 10)


def told(capsys, *words: str) -> dict:
    """The JSON object that `hpac evaluate` prints of a few episodes."""
    assert called(command, *words, "--workers", "1", "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_a_policy_without_a_file_is_evaluated_by_its_name(capsys):
    words = ["--policy", "hpac_gym.evaluation.blind:Blind", "--episodes", "2", "--no-baselines"]
    printed = told(capsys, *words)
    assert (printed["policies"]["learned"]["episodes"], "policy" in printed) == (2, False)


def test_several_policies_are_compared_with_the_first_on_the_same_episodes(capsys, tmp_path):
    files = ["grasp", str(ROOT / "agents" / "trained" / "grasp-robust.hpac")]
    words = [word for name in (*files, files[0]) for word in ("--policy", name)]
    out = tmp_path / "new" / "results.json"
    printed = told(capsys, *words, "--episodes", "2", "--out", str(out))
    assert printed == json.loads(out.read_text())
    assert printed["first_seed"] == HELD_OUT_SEED
    assert list(printed["policies"]) == [*files, "scripted", "random"]
    assert [pair["over"] for pair in printed["differences"]] == [files[1], "scripted", "random"]
    assert [each["file"] for each in printed["files"]] == files


def test_the_environment_and_its_options_are_those_of_the_first_policy_that_has_some(capsys):
    words = ["--policy", "scripted", "--policy", "gentle", "--episodes", "1", "--no-baselines"]
    printed = told(capsys, *words)
    assert printed["env_id"] == "hpac_gym:HPAC-Gentle-v0"
    assert printed["options"] == {"obs": "load", "engine": "mujoco", "body": "twin"}
    assert list(printed["policies"]) == ["scripted", "learned"]


def test_the_workers_of_a_killed_evaluation_end():
    with started("-m", "hpac", *ENDLESS) as running:
        workers = children_of(running, 3)  # with the tracker of their resources
        time.sleep(0.5)
    wait_for_the_end(workers)


def test_the_table_of_elsewhere_has_a_row_for_every_engine_and_body(capsys, tmp_path, monkeypatch):
    """A policy is judged with the options that it needs."""
    given = []

    def evaluated(names, env_id, episodes, *, workers, options):
        given.append(options)
        return SimpleNamespace(summary=lambda: {"policies": {"learned": success_counts(1, 2)}})

    monkeypatch.setattr(reproduce, "evaluate", evaluated)
    out = tmp_path / "cells.json"
    reproduce.main(["elsewhere", "--policy", "gentle", "--out", str(out)])
    lines = capsys.readouterr().out.splitlines()
    assert [{**cell, "obs": "load"} for cell in json.loads(out.read_text())] == [
        {"policy": "gentle", **options, **success_counts(1, 2)} for options in given
    ]
    engines = [engine for engine in ("pybullet", "mujoco") if find_spec(engine)]
    assert len(given) == 3 * (len(lines) - 2) == 3 * (1 + len(engines))
    assert {options["randomize"] for options in given} == {"nominal", "hand", "full"}
    assert lines[-1].startswith("| gentle | mujoco light | 50.0% (")


def test_the_table_of_seeds_has_a_row_for_every_run_and_sums_them_up(capsys, tmp_path):
    policies = ["--policy=grasp", "--policy=grasp", "--policy=agents/trained/grasp-best.hpac"]
    numbers = tmp_path / "cells.json"
    picture = tmp_path / "picture.png"
    words = ["--episodes", "4", "--out", f"{numbers}", "--picture", f"{picture}"]
    reproduce.main(["seeds", *policies, *words])
    *_, first, second, third, _, last = capsys.readouterr().out.splitlines()
    assert first == second
    assert first.startswith("| one-step SAC | 0 | 60,0")
    assert third.startswith("| one-step SAC | 0 | 300,000 ")
    assert last.startswith("one-step SAC, at most 60,000 trials: 2 runs: median "), (
        "the third has another number of trials"
    )
    cells = json.loads(numbers.read_text())
    assert [cell["trials"] for cell in cells] == ["of one run", "of one run", "of several runs"]
    draw_trials(tmp_path / "again.png", cells)
    draw_trials(tmp_path / "other.png", cells[:2])
    drawn = [(tmp_path / f"{name}.png").read_bytes() for name in ("picture", "again", "other")]
    assert drawn[0] == drawn[1] != drawn[2]


def test_several_runs_are_summed_up_by_median_lowest_and_interquartile_mean():
    cells = [{"success_rate": rate} for rate in (0.5, 0.9, 0.8, 0.7, 0.6)]
    assert reproduce.over_runs(cells).startswith(
        "5 runs: median 70.0, lowest 50.0, interquartile mean 70.0 ["
    )
