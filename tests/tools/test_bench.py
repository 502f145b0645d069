"""The workshop's benchmark, and the marks that the model has to keep."""

import re

import numpy as np
import pytest

from hpac_gym.model import HPAC, joints_from_synergy, servo_from_action, servo_from_joints
from tools import bench


def test_every_figure_is_a_line_beside_a_bare_one(monkeypatch, capsys):
    monkeypatch.setattr(bench, "ROUNDS", 1)
    bench.main()
    lines = capsys.readouterr().out.splitlines()
    found = [re.search(r" ([\d.]+) (\S+) +bare +([\d.]+) +× ([\d.]+)$", line) for line in lines]
    assert [row[2] for row in found] == ["µs", "million/s", "ms"]
    assert all(float(row[group]) > 0 for row in found for group in (1, 3, 4))


def test_the_bare_maps_compute_the_same():
    action = np.random.default_rng(1).uniform(-1, 1, (50, 6))
    assert bench.bare_servo_from_action(action) == pytest.approx(
        servo_from_action(action), abs=1e-12
    )
    posture = joints_from_synergy(
        HPAC.synergy_min + 0.5 * (action + 1) * (HPAC.synergy_max - HPAC.synergy_min)
    )
    assert bench.bare_servo_from_joints(posture) == pytest.approx(
        servo_from_joints(posture), abs=1e-12
    )


@pytest.mark.slow
def test_one_command_costs_at_most_25_us_and_a_batch_runs_at_2_million_postures_a_second():
    """The best of some runs: what the machine's other work did not disturb."""
    assert min(bench.cost_of_a_command()[0] for _ in range(5)) <= 25
    assert max(bench.rate_of_a_batch()[0] for _ in range(5)) >= 2
