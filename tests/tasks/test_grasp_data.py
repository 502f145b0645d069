"""The data of the sixteen named grasps: the paper's names and the held-out variants."""

import numpy as np
import pytest

from hpac_gym.body.geometry import rotation_from_rpy
from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.model import HPAC, POSTURES
from hpac_gym.physics.engine import matrix_from_quaternion
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL, quaternion_from_rpy

NAMES = list(GRASPS)
MODELS = load_object_models()


def test_there_is_one_for_each_grasp_posture_of_the_paper():
    assert [name for name, posture in POSTURES.items() if posture.kind == "grasp"] == NAMES
    assert len(NAMES) == 16
    families = {"power", "precision", "lateral", "tool"}
    assert {grasp.family for grasp in GRASPS.values()} == families


def test_every_grasp_has_an_object_of_its_own_and_all_are_used():
    used = [grasp.object for grasp in GRASPS.values()] + [
        grasp.variant("shape").object for grasp in GRASPS.values()
    ]
    assert sorted(model.name for model in used) == sorted(MODELS)


def test_quaternions_are_those_of_the_matrices():
    rpy = (0.4, -1.1, 2.3)
    np.testing.assert_allclose(
        matrix_from_quaternion(quaternion_from_rpy(rpy)), rotation_from_rpy(rpy), atol=1e-12
    )


@pytest.mark.parametrize("name", NAMES)
def test_the_closed_hand_is_within_reach_and_differs_from_the_open_one(name: str):
    grasp = GRASPS[name]
    for synergy in (grasp.preshape, grasp.closed):
        assert np.all(synergy >= HPAC.synergy_min)
        assert np.all(synergy <= HPAC.synergy_max + 1e-9)
    assert np.abs(grasp.closed - grasp.preshape).max() > 0.1
    assert not grasp.closed.flags.writeable


def test_held_out_variants_change_what_they_name():
    def drawn(variant: str) -> ObjectSpec:
        return Grasp(grasp="large_cylinder", variant=variant).setup(np.random.default_rng(0)).object

    spec = {variant: drawn(variant) for variant in (NOMINAL, "heavy", "large")}
    assert spec["heavy"].mass == pytest.approx(1.5 * spec[NOMINAL].mass)
    assert spec["heavy"].half_extents == spec[NOMINAL].half_extents
    assert spec["large"].half_extents == pytest.approx(
        tuple(1.08 * half for half in spec[NOMINAL].half_extents)
    )
    assert all(
        {"large", "small", "heavy", "slippery"} <= set(grasp.held_out) for grasp in GRASPS.values()
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_held_out_shape_is_another_object_of_the_same_mass_and_friction(name: str):
    nominal, shape = (
        Grasp(grasp=name, variant=variant).setup(np.random.default_rng(0)).object
        for variant in (NOMINAL, "shape")
    )
    assert nominal.model is GRASPS[name].object
    assert shape.model is GRASPS[name].variant("shape").object is not nominal.model
    changed = [variant for variant, of in GRASPS[name].held_out.items() if of.object is not None]
    assert changed == ["shape"], "no other variant has another object"
    assert shape.mass == pytest.approx(nominal.mass, rel=0.01)
    assert shape.friction == nominal.friction
