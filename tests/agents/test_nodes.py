"""Collecting on the nodes of a Ray cluster: what a chunk is, and that a run outlives a node and
counts each trial once.
"""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents import RunError, collectors, nodes, train
from agents import runs as runs_of
from agents.closures import Learner
from agents.recipes import RECIPES, with_settings
from agents.runs import saved_trials
from hpac_gym.evaluation.environment import versions
from hpac_gym.policies import read_policy
from tests.processes import wait_for

SETTINGS = {
    "num_envs": "2",
    "hidden": "16",
    "batch_size": "16",
    "random_episodes": "4",
    "checkpoint_every": "30",
}
SMALL = [
    word for name, value in SETTINGS.items() for word in (f"--{name.replace('_', '-')}", value)
]


def test_a_collector_decides_with_what_the_learner_knows():
    recipe = with_settings(RECIPES["grasp"], {"episodes": "40", **SETTINGS})
    collector = collectors.Collector(recipe, 5, versions())
    copy = collector._learner
    learner = Learner(recipe, len(copy.mean), 44, 4)
    rng = np.random.default_rng(0)
    hidden = len(copy.mean) - 44
    seen, came_to = (
        rng.standard_normal((30, width)).astype(np.float32) for width in (len(copy.mean), hidden)
    )
    learner.trials.add(seen, rng.uniform(-1, 1, (30, 8)), rng.integers(0, 5, 30), came_to)
    learner.learn(0.5)
    known = collectors.knowledge(learner)
    assert {type(array) for name in ("actor", "critics") for array in known[name].values()} == {
        np.ndarray
    }
    assert not np.array_equal(
        copy.predicted(seen, np.zeros((30, 8))), learner.predicted(seen, np.zeros((30, 8)))
    )
    trials, steps, seconds = collector.collect(known)
    assert np.array_equal(
        copy.predicted(seen, np.zeros((30, 8))), learner.predicted(seen, np.zeros((30, 8)))
    )
    assert copy.updates == learner.updates
    assert len(trials[0]) >= recipe.num_envs
    assert steps >= 20 * len(trials[0])
    assert seconds > 0
    learner.trials.add(*trials)


def test_a_node_of_other_versions_is_refused():
    with pytest.raises(
        RunError, match=r"the learner has mujoco-core 1\.2, not \S+ as here, on node"
    ):
        collectors.Collector(RECIPES["grasp"], 0, versions() | {"mujoco-core": "1.2"})


def test_without_ray_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(
        RunError,
        match=r"needs Ray, which is not installed: pip install '\.\[nodes\]' in a checkout",
    ):
        collectors.Collectors(RECIPES["grasp"], 2)


def test_the_training_of_a_killed_worker_ends_and_is_continued(tmp_path, monkeypatch):
    recipe = with_settings(RECIPES["grasp"], SETTINGS | {"checkpoint_every": "1"})
    script = f"from agents.nodes import train_seed; from agents.recipes import *; train_seed({recipe}, float('inf'), 'run')"
    worker = subprocess.Popen(
        [sys.executable, "-c", script], env=os.environ | {"TMPDIR": f"{tmp_path}"}, process_group=0
    )
    try:
        wait_for(lambda: saved_trials(tmp_path / "run") or worker.poll() is not None)
        worker.kill()
        worker.wait()
        wait_for(lambda: not processes_of(worker.pid), 10)
    finally:
        os.killpg(worker.pid, signal.SIGKILL) if processes_of(worker.pid) else None
    saved = saved_trials(tmp_path / "run")
    found = []
    assert saved, "it trained"

    def watched(recipe, folder, **limits):
        found.append(saved_trials(folder))
        return train.train(recipe, folder, **limits)

    monkeypatch.setattr(nodes, "train", watched)
    monkeypatch.setattr(nodes, "gettempdir", lambda: f"{tmp_path}")
    monkeypatch.setattr(train, "_stop_on_signal", lambda progress: None)
    files = nodes.train_seed(replace(recipe, episodes=saved + 2), float("inf"), "run")
    assert found == [saved]
    assert f"checkpoint-{saved + 2:09d}/arrays.npz" in files
    assert not (tmp_path / "run").exists()


def test_a_failed_training_keeps_what_was_saved_and_says_where(tmp_path, monkeypatch):
    def fail(recipe, folder, **limits):
        (folder / "checkpoint-000000030").mkdir()
        raise RunError("the training diverged")

    monkeypatch.setattr(nodes, "train", fail)
    monkeypatch.setattr(nodes, "gettempdir", lambda: f"{tmp_path}")
    with pytest.raises(
        RunError,
        match=rf"the training diverged; '{tmp_path}/run' on node '.+' keeps what was saved",
    ):
        nodes.train_seed(RECIPES["grasp"], float("inf"), "run")
    assert saved_trials(tmp_path / "run") == 30


def processes_of(group: int) -> list[Path]:
    """The running processes of a process group."""
    running = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, its_group = path.read_text().rpartition(")")[2].split()[:3]
            running += [path] * (int(its_group) == group and state != "Z")
    return running


@pytest.fixture(scope="module")
def cluster():
    """A cluster of one node with one processor, the head."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        settings = {"RAY_worker_register_timeout_seconds": "600", "RAY_worker_niceness": "0"}
        for name, value in (collectors.QUIET | settings).items():
            monkeypatch.setenv(name, value)
        import ray
        from ray.cluster_utils import Cluster

        made = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
        )
        monkeypatch.setenv("RAY_ADDRESS", made.address)
        yield made
        ray.shutdown()
        made.shutdown()


@pytest.mark.slow
def test_a_run_goes_on_without_a_node_and_is_resumed(cluster, tmp_path, monkeypatch, capsys):
    watched = []

    class Watched(collectors.Collectors):
        """Kills a node as soon as both collectors have given a chunk."""

        def step(self, learner, meanwhile=None):
            if len(self.trials) == 2 and not watched:
                watched.append(self)
                cluster.remove_node(doomed, allow_graceful=False)
            return super().step(learner, meanwhile)

    # before there is a second node: Ray refuses to remove the one that it is connected to
    collectors.connected()
    doomed = cluster.add_node(num_cpus=1)
    monkeypatch.setattr(train, "_stop_on_signal", lambda progress: None)
    monkeypatch.setattr(nodes, "Collectors", Watched)
    words = ["--out", f"{tmp_path}", "--nodes", "2"]
    assert train.main(["grasp", *words, "--episodes", "400", *SMALL]) == 0
    told, said = capsys.readouterr()
    assert "raylet" not in told + said, "Ray's own report of a lost node is fifty lines"
    assert re.search(
        r"collector [01] is lost, and its chunk with it .*: collector 2 takes its place", said
    )
    rows = (tmp_path / "progress.csv").read_text().splitlines()
    assert int(rows[-1].split(",")[0]) == 400 <= sum(watched[0].trials.values())
    assert_no_trial_twice(tmp_path, 400)
    assert train.main([*words[:2], "--nodes", "1", "--resume", "--episodes", "410"]) == 0
    assert_no_trial_twice(tmp_path, 410)


def assert_no_trial_twice(folder, count):
    path = runs_of.latest_checkpoint(folder)
    assert json.loads((path / "state.json").read_text())["episodes"] == count
    assert len(np.unique(np.load(path / "arrays.npz")["seen"], axis=0)) == count


@pytest.mark.slow
def test_a_collector_that_cannot_start_ends_the_run_in_one_line(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(train, "_stop_on_signal", lambda progress: None)
    monkeypatch.setattr(nodes, "versions", lambda: versions() | {"python": "2.7"})
    with pytest.raises(
        RunError, match=r"collector 0 failed: .*the learner has python 2\.7, not \S+ as here"
    ):
        train.main(["grasp", "--out", f"{tmp_path}", "--nodes", "1", *SMALL])


@pytest.mark.slow
def test_a_sweep_trains_a_run_for_each_seed(cluster, tmp_path, capsys):
    assert (
        nodes.main(["grasp", "--seeds", "2", "--out", f"{tmp_path}", "--episodes", "6", *SMALL])
        == 0
    )
    trained = [
        read_policy(tmp_path / f"seed-{seed}" / "policy.hpac").about["settings"]["seed"]
        for seed in (0, 1)
    ]
    assert trained == [0, 1]
    assert all(saved_trials(tmp_path / f"seed-{seed}") >= 6 for seed in (0, 1)), (
        "with its trials, to learn from or to resume"
    )
    words = ["--out", f"{tmp_path}", "--episodes", "6", *SMALL]
    (tmp_path / "seed-1" / "run.json").unlink()  # as if it had been killed while it was written
    kept = (tmp_path / "seed-0" / "policy.hpac").stat().st_mtime_ns
    capsys.readouterr()
    assert nodes.main(["grasp", "--seeds", "2", *words]) == 0
    told = re.findall(
        r"seed-(\d) (was done before, with 6 of 6 trials|is done)", capsys.readouterr().err
    )
    assert told == [("0", "was done before, with 6 of 6 trials"), ("1", "is done")]
    assert (tmp_path / "seed-0" / "policy.hpac").stat().st_mtime_ns == kept
    with pytest.raises(
        RunError,
        match=r"folder '.*seed-0' holds a run with other settings: choose another --out, or remove it",
    ):
        nodes.main(["grasp-type", "--seeds", "1", *words])
    words[1] = f"{tmp_path / 'other'}"
    assert nodes.main(["grasp-type", "--seeds", "1", *words, "--spread", "1"]) == 1
    assert (
        "seed-0 failed: agents.RunError: none of the first 4 trials held" in capsys.readouterr().err
    )
