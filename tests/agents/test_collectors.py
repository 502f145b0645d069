"""Collecting on the nodes of a Ray cluster: what a chunk is, and that a run outlives a node and
counts each trial once.
"""

import json
import re
import sys

import numpy as np
import pytest

from agents import RunError, collectors, runs as runs_of
from agents.recipes import RECIPES, with_settings
from hpac_gym.evaluation.environment import versions
from tests.agents.small import SETTINGS, fitted, train_here, words_of

FEW = SETTINGS | {"num_envs": "2", "random_episodes": "4", "checkpoint_every": "30"}
SMALL = words_of(FEW)


def test_a_collector_decides_with_what_the_learner_knows():
    recipe = with_settings(RECIPES["grasp"], {"episodes": "40", **FEW})
    collector = collectors.Collector(recipe, 5, versions())
    copy = collector._learner
    learner = fitted(recipe, len(copy.networks.mean))
    probe = np.zeros((30, len(copy.networks.mean)), np.float32), np.zeros((30, 8))
    known = collectors.knowledge(learner)
    assert {type(value) for name, value in known.items() if name != "updates"} == {np.ndarray}
    assert not np.array_equal(copy.predicted(*probe), learner.predicted(*probe))
    trials, steps, seconds = collector.collect(known)
    assert np.array_equal(copy.predicted(*probe), learner.predicted(*probe))
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
    monkeypatch.setattr(collectors, "Collectors", Watched)
    train_here("grasp", "--out", tmp_path, "--nodes", 2, "--episodes", 400, *SMALL)
    told, said = capsys.readouterr()
    assert "raylet" not in told + said, "Ray's own report of a lost node is fifty lines"
    assert re.search(
        r"collector [01] is lost, and its chunk with it .*: collector 2 takes its place", said
    )
    rows = (tmp_path / "progress.csv").read_text().splitlines()
    assert int(rows[-1].split(",")[0]) == 400 <= sum(watched[0].trials.values())
    assert_no_trial_twice(tmp_path, 400)
    train_here("--out", tmp_path, "--nodes", 1, "--resume", "--episodes", 410)
    assert_no_trial_twice(tmp_path, 410)


def assert_no_trial_twice(folder, count):
    path = runs_of.latest_checkpoint(folder)
    assert json.loads((path / "state.json").read_text())["episodes"] == count
    assert len(np.unique(np.load(path / "arrays.npz")["seen"], axis=0)) == count


@pytest.mark.slow
def test_a_collector_that_cannot_start_ends_the_run_in_one_line(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr(collectors, "versions", lambda: versions() | {"python": "2.7"})
    with pytest.raises(
        RunError, match=r"collector 0 failed: .*the learner has python 2\.7, not \S+ as here"
    ):
        train_here("grasp", "--out", tmp_path, "--nodes", 1, *SMALL)
