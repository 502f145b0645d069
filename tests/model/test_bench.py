"""The benchmark's figures, and the marks that the model has to keep."""

import json

import numpy as np
import pytest

from hpac_gym import bench
from hpac_gym.model import HPAC, joints_from_synergy, servo_from_action, servo_from_joints


def test_bench_prints_one_object_with_both_figures(capsys):
    assert bench.main(["--section", "model", "--json"]) == 0
    one, batch = json.loads(capsys.readouterr().out)["model"]
    assert (one["unit"], batch["unit"]) == ("µs", "million/s")
    for row in (one, batch):
        assert row["value"] > 0
        assert row["ratio"] > 0


def test_bench_prints_a_line_a_figure(capsys):
    assert bench.main(["--section", "model"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "model"
    assert len([line for line in lines if " bare " in line]) == len(lines) - 1 == 2


def test_the_bare_maps_of_the_bench_compute_the_same():
    action = np.random.default_rng(1).uniform(-1, 1, (50, 6))
    assert bench.bare_servo_from_action(action) == pytest.approx(servo_from_action(action), abs=1e-12)
    posture = joints_from_synergy(HPAC.synergy_min + 0.5 * (action + 1) * (HPAC.synergy_max - HPAC.synergy_min))
    assert bench.bare_servo_from_joints(posture) == pytest.approx(servo_from_joints(posture), abs=1e-12)


@pytest.mark.slow
def test_one_command_costs_at_most_25_us_and_a_batch_runs_at_2_million_postures_a_second():
    """The best of some runs: what the machine's other work did not disturb."""
    runs = [bench.model_rows() for _ in range(5)]
    assert min(one.value for one, _ in runs) <= 25
    assert max(batch.value for _, batch in runs) >= 2
