"""`python -m experiments.agree`: which episodes it compares, and why PyBullet loses round objects
that MuJoCo holds."""

import json

import pytest

from experiments import agree
from experiments.agree import Trial, agreement, compare
from hpac_gym.errors import ParameterError
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.physics.simulation import make_engine


def test_it_compares_paired_episodes():
    first = [Trial(True, "box"), Trial(False, "box"), Trial(True, "box"), Trial(True, "box")]
    second = [Trial(True, "box")] * 4
    found = compare(first, second)
    assert (found["difference"] > 0, found["agree"]) == (True, 0.75)


def test_the_command_runs_an_engine_with_other_contacts(capsys):
    words = "--policy scripted -n 1 --workers 1 --no-floor --json --set-ups mujoco/twin mujoco/twin/no-torsion"
    agree.main(words.split())
    plain, other = json.loads(capsys.readouterr().out)["set_ups"]
    assert (plain["set_up"], other["set_up"], other["over"]) == (
        "mujoco/twin",
        "mujoco/twin/no-torsion",
        "mujoco/twin",
    )
    assert plain["floor"] == {}
    assert other["agree"] in (0.0, 1.0)


@pytest.mark.pybullet
def test_torsional_friction_needs_bullets_iterative_solver():
    with pytest.raises(ParameterError, match=r"torsion = 0\.005 m needs Bullet's iterative solver"):
        make_engine("pybullet", settings=WorldSettings(torsion=0.005))


@pytest.mark.slow
@pytest.mark.pybullet
def test_the_iterative_solver_and_torsional_friction_make_pybullet_hold_what_mujoco_holds():
    set_ups = ["mujoco/twin", "pybullet/twin", "pybullet/twin/iterative+torsion"]
    found = agreement("grasp", 150, set_ups, seed_start=1_600_000, floor=False)
    _, direct, iterative = found["set_ups"]
    assert direct["difference"] < -0.06
    assert abs(iterative["difference"]) < 0.08  # three standard errors
    assert iterative["agree"] > direct["agree"]
