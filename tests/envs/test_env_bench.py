"""The environments' benchmark: what its figures are, not how high."""

import json

import numpy as np
import pytest

from hpac_gym import bench, env_bench


@pytest.fixture
def short(monkeypatch):
    """Rounds of a few steps, and processes that work for a moment."""
    monkeypatch.setattr(env_bench, "ROUNDS", 2)
    monkeypatch.setattr(env_bench, "ROUND_STEPS", 6)
    monkeypatch.setattr(env_bench, "together", lambda task, processes, seconds=0.0: 10.0 * min(processes, 2))


def test_the_report_has_the_figures_of_both_motions(short, capsys):
    assert bench.main(["--section", "env", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["env"]
    assert found["physics_hz"] % found["control_hz"] == 0
    for motion in (found["free"], found["contact"]):
        assert set(motion) == {"env_steps_per_second", "real_time_factor", "reset_ms", "outside_physics_share"}
        assert motion["env_steps_per_second"] / motion["real_time_factor"] == pytest.approx(found["control_hz"])
        assert 0 < motion["outside_physics_share"] < 1
    assert [row["processes"] for row in found["scaling"]] == [2, 4]
    assert found["renders_per_second"] > 0


def test_the_report_can_be_read(short, capsys):
    assert bench.main(["--section", "env"]) == 0
    text = capsys.readouterr().out
    for word in ("free", "contact", "pictures", "processes", env_bench.PEER):
        assert word in text


@pytest.mark.parametrize(("name", "touched"), [("free", False), ("contact", True)])
def test_free_is_without_contact_and_contact_with(name, touched):
    runner = env_bench.Runner(name)
    runner.warm_up()
    assert bool(runner.env.scene.contact_forces()) is touched
    runner.env.close()


def test_the_timer_changes_no_trajectory():
    runner = env_bench.Runner("contact")
    plain = env_bench.HandEnv(env_bench.Grasp())
    plain.reset(seed=0, options={"setup": env_bench.SETUPS["contact"]})
    motion = env_bench.actions("contact")
    for _ in range(10):
        action = next(motion)
        np.testing.assert_array_equal(plain.step(action)[0], runner.env.step(action)[0])
    runner.env.close()
    plain.close()


@pytest.mark.slow
def test_processes_run_side_by_side():
    assert env_bench.together("env", 2, seconds=0.5) > 0
    assert env_bench.together("arithmetic", 2, seconds=0.2) > 0
