"""Every engine and body meets the same marks, and the suite sees a hand that does not."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from experiments import conformance
from experiments.conformance import figures, free_space, slack_droop, stiffest_mode
from hpac_gym.model import HPAC
from hpac_gym.physics.settings import BODIES, WorldSettings
from hpac_gym.physics.simulation import SET_UPS, make_engine

WORLD = WorldSettings()


@pytest.mark.parametrize("postures", [3, pytest.param(25, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("engine", "body"), [set_up.split("/") for set_up in SET_UPS])
def test_marks_are_met(engine, body, postures):
    found = figures(partial(make_engine, engine), body, postures=postures)
    assert not {figure.name: figure.value for figure in found if not figure.holds}


@pytest.mark.slow
@pytest.mark.pybullet
def test_bullets_iterative_solver_meets_the_marks_too():
    iterative = WorldSettings(solver_iterations=200)
    assert all(
        figure.holds for figure in figures(partial(make_engine, "pybullet"), "twin", iterative)
    )


def test_the_twin_is_fit_for_explicit_torques():
    assert 1.0 < stiffest_mode(BODIES["twin"], WORLD) < 1.5
    assert stiffest_mode(BODIES["light"], WORLD) > 5.0


def test_light_fingers_without_their_servos_inertia_chatter():
    """Negative control: what `hub_inertia` is there for."""
    bare = replace(BODIES["light"], hub_inertia=0.0)
    manifold, command, speed = free_space(partial(make_engine, "mujoco"), bare, WORLD, postures=8)
    assert manifold > 1e-3
    assert command > 0.3
    assert speed > 0.05


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_another_hand_is_seen(engine, monkeypatch):
    """Negative control: the couplings of the simulated hand are 10 % softer than those of the
    equations.
    """
    soft = replace(
        HPAC,
        digits={
            n: replace(d, tendon_stiffness=0.9 * d.tendon_stiffness) for n, d in HPAC.digits.items()
        },
    )
    make = conformance.SceneSetup
    monkeypatch.setattr(
        conformance,
        "SceneSetup",
        lambda *arguments, **given: make(*arguments, **given | {"hand": soft}),
    )
    manifold, _, _ = free_space(partial(make_engine, engine), BODIES["twin"], WORLD, postures=4)
    assert manifold > 1e-3


@pytest.mark.parametrize("engine", ["pybullet", "mujoco"])
def test_heavier_weight_droops_more(engine):
    """Negative control: the fingers hang where weight and spring balance."""
    make = partial(make_engine, engine)
    droop = slack_droop(make, BODIES["twin"], WORLD)
    assert (
        slack_droop(make, BODIES["twin"], replace(WORLD, gravity=2 * WORLD.gravity)) > 1.5 * droop
    )


def test_a_figure_of_which_one_part_is_no_number_is_missed(monkeypatch):
    parts = {
        "free_space": lambda *_: (0.0, 0.0, 0.0),
        "blocked_fingertip": lambda *_: (0.0, np.nan),
        "held_cylinder": lambda *_: (0.0, 0.0),
        "slack_droop": lambda *_: 0.0,
        "opposition_gap": lambda *of: np.nan if of[-1] == "middle" else 0.0,
    }
    for name, part in parts.items():
        monkeypatch.setattr(conformance, name, part)
    missed = [figure.name.partition(":")[0] for figure in figures(None) if not figure.holds]
    assert missed == ["opposition", "chatter"]


@pytest.mark.parametrize(("value", "status"), [(0.5, 0), (1.5, 1)])
def test_the_command_prints_every_figure_and_fails_on_a_missed_mark(
    value, status, monkeypatch, capsys
):
    monkeypatch.setattr(
        conformance,
        "figures",
        lambda make, body, world: [conformance.Figure("gap", value, 1.0, "mm")],
    )
    assert conformance.main(["--engine", "mujoco"]) == status
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if not line.startswith(" ")] == ["mujoco/twin", "mujoco/light"]
    assert all(("MISSED" in line) == (status == 1) for line in lines if line.startswith(" "))
    words = ["--engine", "mujoco", "--body", "light", "--json"]
    assert conformance.main(words) == status
    (figure,) = json.loads(capsys.readouterr().out)["mujoco/light"]
    assert figure == {
        "name": "gap",
        "value": value,
        "limit": 1.0,
        "unit": "mm",
        "holds": status == 0,
    }
