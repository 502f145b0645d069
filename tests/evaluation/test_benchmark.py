"""The protocol: a results file that says what was played, goes on after an interruption, and is
refused once it is wrong.
"""

import copy
import json
import shlex
import sys
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from agents.trials import SHORT
from hpac_gym.envs import GraspAny
from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import checked_options
from hpac_gym.evaluation import benchmark, results as results_file, splits
from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.evaluation.results import comparison, faults, table
from hpac_gym.evaluation.splits import ResultsError, env_hash, splits_of
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.policies import Closures, PolicyError, write_policy
from hpac_gym.policies.export import export
from hpac_gym.policies.policy import EpisodePolicy
from hpac_gym.registration import GRASP_ANY, GRASP_TYPE, POSTURE
from hpac_gym.tasks.task import RUNNING, SUCCESS
from tests.options import called
from tests.policies.episodes import tiny_policy
from tests.processes import killed_at_the_second

TINY = "tests.tiny_task:Tiny-v0"
RESULTS = Path(__file__).parents[2] / "docs" / "results"
POINTER = "tests.evaluation.test_benchmark:Pointer:{seed}"


class Pointer(EpisodePolicy):
    """Points where the observation of Tiny-v0 points, with an error that grows with the seed of its
    run.
    """

    def __init__(self, env, run):
        self._error = 0.5 + 0.05 * int(run)

    def set_random_seed(self, seed):
        self._seed = seed

    def _act(self, observation, memory):
        rng = memory or np.random.default_rng(self._seed)
        miss = rng.uniform(-1, 1, 6) * self._error
        return np.clip(observation + miss, -1, 1).astype(np.float32), rng


@pytest.fixture(scope="module", autouse=True)
def tiny():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(splits.SPLITS, TINY, {"one": {}, "two": {}})
        patch.setattr(results_file, "EPISODES", 40)
        yield


def submit(path, *words, policy=POINTER):
    given = [TINY, "--policy", policy, "--episodes", "40", "--out", path]
    assert called(benchmark, *given, *words) == 0
    return json.loads(path.read_text())


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    return submit(tmp_path_factory.mktemp("trained") / "results.json", "--budget", "1e5")


def test_a_training_is_judged_by_five_runs_in_every_split(trained):
    assert not list(faults(trained))
    assert {(cell["seed"], cell["split"]) for cell in trained["cells"]} == {
        (s, n) for s in range(5) for n in ("one", "two")
    }
    won = [cell["successes"] for cell in trained["cells"] if cell["split"] == "one"]
    episodes = evaluate([POINTER.replace("{seed}", "3")], TINY, 40, seed_start=2_000_000).episodes[
        "learned"
    ]
    assert won[3] == sum(episode.success for episode in episodes)
    assert won[0] > won[4], "the last one points less well"
    assert trained["summary"][0]["iqm"] == pytest.approx(sum(sorted(won)[1:4]) / 3 / 40)
    assert f"| {', '.join(f'{100 * n / 40:.1f}' for n in won)} | end" in table(trained)


def test_what_nobody_trained_has_one_run_with_its_wilson_interval(tmp_path, capsys, monkeypatch):
    words = ["hpac", "benchmark", TINY, "--about", "a line, see there"]
    monkeypatch.setattr(sys, "argv", words)
    results = submit(tmp_path / "random.json", policy="hpac_gym.policies.baselines:RandomPolicy")
    assert shlex.split(results["command"]) == words
    (cell, _) = results["cells"]
    (row, *_) = results["summary"]
    assert row["iqm"] == cell["successes"] / 40
    assert cell["interval_95"] == list(wilson_interval(cell["successes"], 40))
    assert called(benchmark, "--check", tmp_path / "random.json") == 0
    assert "valid" in capsys.readouterr().out
    assert called(benchmark, "--check", tmp_path / "random.json", "--json") == 0
    (told,) = json.loads(capsys.readouterr().out)["files"]
    assert (told["faults"], told["summary"]) == ([], results["summary"])


def test_five_models_of_stable_baselines3_are_judged_with_their_statistics(tmp_path, monkeypatch):
    """Named apart from them, since none lies beside its model."""
    monkeypatch.setattr(results_file, "EPISODES", 4)
    for seed in range(5):
        envs = VecNormalize(DummyVecEnv([lambda: gymnasium.make(TINY)]))
        model = PPO("MlpPolicy", envs, n_steps=16, batch_size=16, seed=seed, device="cpu").learn(16)
        model.save(tmp_path / f"{seed}" / "model.zip")
        envs.save(str(tmp_path / f"statistics_{seed}.pkl"))
    words = ("--budget", "1e5", "--episodes", "4")
    statistics = ("--normalize", f"{tmp_path}/statistics_{{seed}}.pkl")
    policy = f"{tmp_path}/{{seed}}/model.zip"
    results = submit(tmp_path / "out.json", *words, *statistics, policy=policy)
    assert not list(faults(results))
    assert len({file["sha256"] for file in results["files"]}) == 5
    assert len({file["normalize_sha256"] for file in results["files"]}) == 5
    assert [file["env_steps"] for file in results["files"]] == [16] * 5
    with pytest.raises(PolicyError, match="was trained on normalised observations"):
        submit(tmp_path / "other.json", *words, policy=policy)


@pytest.fixture
def judged(monkeypatch):
    """Seed and split of every cell that is judged."""
    cells = []
    judge = benchmark.judge
    monkeypatch.setattr(
        benchmark, "judge", lambda *job: cells.append((job[2], job[1])) or judge(*job)
    )
    return cells


def test_an_interrupted_call_goes_on_after_its_last_cell(tmp_path, trained, judged):
    path = tmp_path / "results.json"
    with killed_at_the_second(benchmark, "judge"):
        submit(path, "--budget", "1e5")
    assert len(json.loads(path.read_text())["cells"]) == 1
    assert submit(path, "--budget", "1e5") | {"command": None} == trained | {"command": None}
    assert len(judged) == len(set(judged)) == 10
    with pytest.raises(
        ResultsError, match=r"holds results with policy '.*Pointer.*', not 'random'"
    ):
        submit(path, policy="random")


@pytest.fixture
def partial(tmp_path, monkeypatch):
    """A results file from a machine without PyBullet."""
    of_tiny = {"one": {}, "two": {}, "PyBullet": {"engine": "pybullet"}}
    monkeypatch.setitem(splits.SPLITS, TINY, of_tiny)
    monkeypatch.setattr(benchmark, "is_installed", lambda engine: engine != "pybullet")
    env_hash.cache_clear()
    with pytest.warns(UserWarning, match="not installed: the file will lack PyBullet"):
        results = submit(tmp_path / "results.json", policy="random")
    yield results
    env_hash.cache_clear()


def test_a_file_without_pybullet_is_valid_marked_and_compared_on_what_both_have(partial):
    assert not list(faults(partial))
    assert partial["left_out"] == ["PyBullet"]
    assert [cell["split"] for cell in partial["cells"]] == ["one", "two"]
    assert [row["split"] for row in partial["summary"]] == ["one", "two", "all splits"]
    assert "**partial: without PyBullet**" in table(partial).splitlines()[0]
    for left_out, told in (
        (["one"], "split 'one' is left out: only those of PyBullet may be"),
        (["three"], "left_out names 'three', which is no split"),
        ([], "split 'PyBullet' of seed 0 is missing"),
    ):
        assert told in list(faults(partial | {"left_out": left_out}))
    cells = [*partial["cells"], partial["cells"][0] | {"split": "PyBullet"}]
    told = comparison(partial, partial | {"cells": cells, "left_out": []})
    assert told.endswith(": 0.50"), "one run of each has no spread, and no interval of width 0"


@pytest.fixture
def added(monkeypatch):
    """Tiny-v0 is given a third split, after files have been made."""
    monkeypatch.setitem(splits.SPLITS, TINY, {"one": {}, "two": {}, "three": {}})
    monkeypatch.setitem(splits.ADDED, TINY, ("three",))
    env_hash.cache_clear()
    yield
    env_hash.cache_clear()


def test_a_file_from_before_a_split_stays_valid_and_is_marked(trained, added, monkeypatch):
    assert not list(faults(trained))
    assert "**partial: without three**" in table(trained).splitlines()[0]
    here = trained | {"env_sha256": env_hash(TINY)}
    assert "split 'three' of seed 0 is missing" in list(faults(here)), "a file of today needs it"
    assert "left_out" not in trained
    monkeypatch.setitem(splits.ADDED, TINY, ())
    assert any("is not that of this version" in fault for fault in faults(trained))


def test_a_split_that_was_added_is_judged_alone(tmp_path, trained, added, judged):
    path = tmp_path / "results.json"
    path.write_text(json.dumps(trained))
    results = submit(path, "--budget", "1e5")
    assert judged == [(seed, "three") for seed in range(5)]
    assert not list(faults(results))
    assert results["env_sha256"] == env_hash(TINY) != trained["env_sha256"]
    assert results["cells"][:10] == trained["cells"]


@pytest.mark.parametrize("cells", [None, [1], [{"seed": 0}], [{"seed": 9, "split": "nominal"}]])
def test_a_results_file_with_other_cells_is_not_continued(tmp_path, trained, cells):
    path = tmp_path / "results.json"
    path.write_text(json.dumps(trained | {"cells": cells}))
    before = path.read_bytes()
    with pytest.raises(ResultsError, match=r"cannot continue results file '.*results\.json'"):
        submit(path, "--budget", "1e5")
    assert path.read_bytes() == before


def broken(results, *path, value):
    """A copy with one value changed; None removes it."""
    results = copy.deepcopy(results)
    *way, last = path
    place = results
    for step in way:
        place = place[step]
    if value is None:
        del place[last]
    else:
        place[last] = value
    return results


@pytest.mark.parametrize(
    ("path", "value", "told"),
    [
        (("schema",), "hpac-benchmark-0", "schema is 'hpac-benchmark-0', not"),
        (("env_sha256",), "0" * 64, "env_sha256 000000000000… is not that of this version"),
        (("budget",), 200_000, "budget is 200000: it must be one of"),
        (("seeds",), [0, 1, 2, 3], "a trained policy has 5 from 0 on"),
        (("episodes",), 39, "a submission has at least 40"),
        (("first_seed",), 0, "first_seed is 0, not 2000000"),
        (("training_seeds",), [0, 2_000_000], "training seeds are 0 to 2000000: they must lie"),
        (("training_seeds",), [0, 1_000_000], "they must lie in 0 to 999999, in order"),
        (("training_seeds",), [2_500_000, 0], "they must lie in 0 to 999999, in order"),
        (("policy",), None, "field 'policy' is missing"),
        (("command",), None, "field 'command' is missing"),
        (
            ("files",),
            [{"sha256": "", "env_steps": 100_001}],
            "trained for 100,001 steps, over the budget of 100,000",
        ),
        (("files",), [{"sha256": "a"}] * 5, "each of 5 runs has its own, or none has one"),
        (("files",), [{"sha256": "a"}, {"sha256": "b"}], "files are 2: each of 5 runs has its own"),
        (("files",), [{"sha256": name} for name in "abcdee"], "files are 6: each of 5 runs has"),
        (("versions", "mujoco-core"), None, "version of mujoco-core is missing"),
        (("cells", 4), None, "split 'one' of seed 2 is missing"),
        (("cells", 0, "split"), "two", "split 'two' of seed 0 occurs 2 times"),
        (("cells", 0, "split"), "three", "split 'three' of seed 0 is unexpected"),
        (("cells", 0, "successes"), 41, "split 'one' of seed 0: 41 successes and"),
        (("cells", 0, "failures", "end"), -1, "failures do not make 40 episodes"),
        (("cells", 0, "interval_95", 0), 0.0, "is not Wilson's of"),
        (("cells", 0, "holding_force"), float("nan"), "holding_force is nan N"),
        (("summary", 0, "iqm"), 0.99, "summary does not follow from the cells"),
        (("summary", 2, "interval_95", 1), 0.99, "summary does not follow from the cells"),
        (("cells", 0, "successes"), None, "field 'successes' is missing"),
        (("cells", 0, "failures"), 3, "a field has a wrong value"),
        (("episodes",), 0, "a field has a wrong value: division by zero"),
    ],
)
def test_a_results_file_that_was_changed_is_refused_with_its_fault(trained, path, value, told):
    found = list(faults(broken(trained, *path, value=value)))
    assert found, "no fault was told"
    assert any(told in fault for fault in found), found
    assert not any("\n" in fault for fault in found)


def test_check_tells_every_fault_in_a_line_and_ends_with_status_1(trained, tmp_path, capsys):
    path = tmp_path / "bad.json"
    path.write_text(
        json.dumps(broken(broken(trained, "env_sha256", value="0"), "first_seed", value=5_000_000))
    )
    assert called(benchmark, "--check", path) == 1
    assert [line.split(":")[0] for line in capsys.readouterr().out.splitlines()] == [str(path)] * 2


def test_two_files_are_compared_by_the_probability_of_improvement(trained):
    worse = copy.deepcopy(trained)
    for cell in worse["cells"]:
        cell["successes"] = 0
    assert comparison(trained, worse).endswith("1.00 [1.00, 1.00]")
    assert ": 0.50 [" in comparison(trained, trained)


def test_the_hash_changes_with_the_objects_and_the_files_of_calibrated_hands(tmp_path, monkeypatch):
    alone = splits.ADDED[GRASP_ANY]
    before = [env_hash(GRASP_ANY), env_hash(GRASP_ANY, alone)]
    with monkeypatch.context() as patch:
        patch.setattr(splits, "FILES", tmp_path)
        assert env_hash.__wrapped__(GRASP_ANY) != before[0]
        assert env_hash.__wrapped__(GRASP_ANY, alone) == before[1]
    monkeypatch.setattr(splits, "object_set", lambda split: ())
    assert env_hash.__wrapped__(GRASP_ANY, alone) != before[1]


@pytest.mark.parametrize("path", sorted(RESULTS.glob("*.json")), ids=lambda path: path.stem)
def test_the_results_of_the_repository_are_valid(path):
    results = results_file.read(path)
    assert not list(faults(results))
    assert str(path.relative_to(RESULTS.parents[1])) in results["command"]


def test_every_split_differs_from_the_first_in_one_thing_or_from_one_that_does():
    for of_id in map(splits_of, splits.SPLITS):
        for options in of_id.values():
            assert (
                min(
                    len(options.items() ^ other.items())
                    for other in of_id.values()
                    if other is not options
                )
                <= 2
            )


@pytest.mark.slow
def test_what_nobody_trained_on_types_and_postures_is_as_far_apart_as_the_results_say():
    """On other seeds than theirs: what knows the type or sees the goal wins, random actions do not,
    one closure is in between.
    """
    shares = {}
    for env_id, other in (
        (GRASP_TYPE, "hpac_gym.policies.baselines:one_closure:small_cylinder"),
        (POSTURE, "hpac_gym.policies.baselines:constant_posture"),
    ):
        options = next(iter(splits_of(env_id).values()))
        judged = evaluate(
            ["scripted", other, "random"], env_id, 100, seed_start=8_000_000, options=options
        )
        shares[env_id] = [
            np.mean([episode.success for episode in episodes])
            for episodes in judged.episodes.values()
        ]
    assert shares[GRASP_TYPE][0] > 0.85
    assert 0.1 < shares[GRASP_TYPE][1] < 0.6
    assert shares[POSTURE][0] > 0.6
    assert shares[POSTURE][1] < 0.1
    assert shares[GRASP_TYPE][2] < 0.03 > shares[POSTURE][2]


@pytest.mark.slow
def test_what_training_leaves_out_of_an_episode_of_any_objects_changes_few_outcomes():
    """The same random closures in episodes of full length and in those that `grasp-any` trains
    on.
    """
    held = []
    decisions = np.random.default_rng(3).uniform(-1, 1, (96, 8))
    for task in (GraspAny(), GraspAny(config=SHORT)):
        episodes = Episodes(task, len(decisions), checked_options(engine="mujoco"))
        episodes.reset(
            range(len(decisions)),
            [np.random.default_rng(7_700_000 + world) for world in range(len(decisions))],
        )
        won = np.zeros(len(decisions), bool)
        over = np.zeros(len(decisions), bool)
        step = 0
        while not over.all():
            episodes.step(Closures().actions(decisions, np.full(len(decisions), step)))
            won |= ~over & (episodes.outcome == SUCCESS)
            over |= episodes.outcome != RUNNING
            step += 1
        held.append(won)
        episodes.close()
    assert 0.1 < held[0].mean() < 0.9
    assert (held[0] != held[1]).mean() < 0.05


def test_five_runs_of_one_seed_are_refused_before_they_are_judged(tmp_path):
    for seed in range(5):
        write_policy(tmp_path / f"{seed}.hpac", tiny_policy(seconds=seed))
    with pytest.raises(ResultsError, match="two of its 5 runs have the same weights"):
        submit(tmp_path / "r.json", "--budget", "1e5", policy=f"{tmp_path}/{{seed}}.hpac")


def test_an_exported_policy_is_a_file_with_its_steps_and_a_baseline_s_name_is_none(
    tmp_path, capsys, monkeypatch
):
    pytest.importorskip("onnxruntime")
    write_policy(tmp_path / "policy.hpac", tiny_policy(env_steps=9_000))
    export(tmp_path / "policy.hpac", tmp_path / "out")
    (tmp_path / "random").write_text("a file of that name")
    monkeypatch.chdir(tmp_path)
    for policy, known in (("out", 1), ("random", 0)):
        results = submit(Path(f"{policy}.json"), policy=policy)
        assert [file["env_steps"] for file in results["files"]] == [9_000] * known
        told = capsys.readouterr()
        assert ("trained for 9,000 steps, over the budget of 0" in told.err) == bool(known)
        assert ("no budget named" if known else "not trained") in told.out


def test_the_same_weights_in_a_file_that_was_written_again_are_the_same_policy(tmp_path, judged):
    for seconds in (1, 2):
        write_policy(tmp_path / "policy.hpac", tiny_policy(seconds=seconds))
        submit(tmp_path / "results.json", policy=f"{tmp_path}/policy.hpac")
    assert len(judged) == 2
