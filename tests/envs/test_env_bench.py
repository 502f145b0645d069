"""The environments' benchmark: what its figures are, not how high."""

import json
from dataclasses import replace

import numpy as np
import pybullet
import pytest

from hpac_gym import bench, env_bench
from hpac_gym.env_bench import motion, peers, scaling
from hpac_gym.envs import Grasp, HandEnv


@pytest.fixture
def short(monkeypatch):
    """Rounds of a few steps, processes that work for a moment, and one small vector environment."""
    monkeypatch.setattr(motion, "ROUNDS", 2)
    monkeypatch.setattr(motion, "ROUND_STEPS", 6)
    monkeypatch.setattr(scaling, "SECONDS", 0.05)
    monkeypatch.setattr(scaling, "ROUNDS", 1)
    monkeypatch.setattr(scaling, "NUM_ENVS", (2,))
    monkeypatch.setattr(scaling, "together", lambda task, processes: 10.0 * min(processes, 2))


def test_the_report_has_the_figures_of_both_motions(short, capsys):
    assert bench.main(["--section", "env", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["env"]
    assert found["physics_hz"] % found["control_hz"] == 0
    for figures in (found["free"], found["contact"]):
        assert set(figures) == {"env_steps_per_second", "real_time_factor", "reset_ms", "outside_physics_share"}
        assert figures["env_steps_per_second"] / figures["real_time_factor"] == pytest.approx(found["control_hz"])
        assert 0 < figures["outside_physics_share"] < 1
    assert [(row["processes"], row["share_of_arithmetic"]) for row in found["scaling"]] == [(2, 1.0), (4, 1.0)]
    assert [row["num_envs"] for row in found["vector"]] == [2]
    assert found["vector"][0]["ratio"] > 0
    assert found["renders_per_second"] > 0
    for peer in found["peers"]:
        assert set(peer["ratio"]) == {"free", "contact"}


def test_the_report_can_be_read(short, capsys):
    assert bench.main(["--section", "env"]) == 0
    text = capsys.readouterr().out
    for word in ("free", "contact", "pictures", "processes", "AsyncVectorEnv", *env_bench.PEERS):
        assert word in text


@pytest.fixture
def report() -> env_bench.Report:
    """Figures that keep every mark, just."""
    one = env_bench.Motion(500.0, 25.0, 5.0, 0.40)
    rows = (env_bench.Scaling(2, 900.0, 1.8, 2.0, 0.90),)
    peer = env_bench.Peer(env_bench.MARKED_PEER, 25.0, 499.0, {"free": 1.01, "contact": 1.01})
    other = env_bench.Peer("HandManipulateBlock-v1", 25.0, 1000.0, {"free": 0.5, "contact": 0.5})
    return env_bench.Report(240, 20, one, one, 30.0, rows, (), (peer, other))


def missed(report: env_bench.Report) -> int:
    return "\n".join(report.lines()[1:]).count("✗")


def test_the_lines_say_which_marks_are_kept(report):
    assert missed(report) == 0
    assert "\n".join(report.lines()[1:]).count("✓") == 7
    assert missed(replace(report, free=replace(report.free, reset_ms=5.01))) == 1
    assert missed(replace(report, contact=replace(report.contact, outside_physics_share=0.401))) == 1
    assert missed(replace(report, scaling=(replace(report.scaling[0], share_of_arithmetic=0.899),))) == 1
    assert missed(replace(report, peers=(replace(report.peers[0], ratio={"free": 1.01, "contact": 1.0}),))) == 1


def test_peers_that_are_not_installed_are_named(report, monkeypatch):
    monkeypatch.setitem(peers.PEERS, "Nobody-v0", "no_such_module")
    assert peers.made("Nobody-v0") is None
    assert "Nobody-v0: not installed" in report.lines()[-1]


@pytest.mark.parametrize(("name", "touched"), [("free", False), ("contact", True)])
def test_free_is_without_contact_and_contact_with(name, touched):
    """In every physics step of a whole episode, of the hand with the object and with itself."""
    runner = motion.Runner(name)
    world, hand = runner.env.scene.world, runner.env.scene.hand.body
    step, touches = world.step, []

    def watched() -> None:
        step()
        touches.append(len(pybullet.getContactPoints(bodyA=hand, physicsClientId=world.client)))

    world.step = watched
    moves, over = motion.actions(name), False
    steps = 0
    while not over:
        over = runner.env.step(next(moves))[2]
        steps += 1
    assert steps > motion.WARM_UP_STEPS
    assert any(touches) is touched
    runner.env.close()


def test_the_timer_changes_no_trajectory():
    runner = motion.Runner("contact")
    plain = HandEnv(Grasp())
    plain.reset(seed=0, options={"setup": motion.SETUPS["contact"]})
    moves = motion.actions("contact")
    for _ in range(10):
        action = next(moves)
        np.testing.assert_array_equal(plain.step(action)[0], runner.env.step(action)[0])
    runner.env.close()
    plain.close()


@pytest.mark.slow
def test_processes_run_side_by_side():
    assert scaling.together("env", 2, seconds=0.5) > 0
    assert scaling.together("arithmetic", 2, seconds=0.2) > 0
