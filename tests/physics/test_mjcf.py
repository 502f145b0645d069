"""The MJCF says what the URDF, the parameters and the tendon law say."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from hpac_gym.body.geometry import load_geometry
from hpac_gym.model import FINGERS, HPAC, JOINTS, joints_from_synergy, servo_from_synergy
from hpac_gym.physics.mechanics import mass_matrix
from hpac_gym.physics.mjcf import FILES
from hpac_gym.physics.settings import BODIES
from hpac_gym.physics.tendons import Tendons

ASSETS = Path(__file__).parents[2] / "assets"
GEOMETRY = load_geometry()


def loaded(name: str):
    model = mujoco.MjModel.from_xml_path(str(ASSETS / "mjcf" / name))
    return model, mujoco.MjData(model)


def dofs(model) -> list[int]:
    return [model.joint(name).dofadr[0] for name in JOINTS]


def set_joints(model, data, angles) -> None:
    for name, angle in zip(JOINTS, angles, strict=True):
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)


def test_bodies_are_those_of_the_urdf():
    model, data = loaded("hpac_hand.xml")
    urdf = mujoco.MjModel.from_xml_path(str(ASSETS / "urdf" / "hpac_hand.urdf"))
    other = mujoco.MjData(urdf)
    rng = np.random.default_rng(0)
    links = [phalanx.link for phalanx in GEOMETRY.phalanges]
    for _ in range(5):
        angles = rng.uniform(HPAC.joint_min, HPAC.joint_max)
        set_joints(model, data, angles)
        set_joints(urdf, other, angles)
        for link in links:
            np.testing.assert_allclose(data.body(link).xpos, other.body(link).xpos, atol=1e-8)
            np.testing.assert_allclose(data.body(link).xmat, other.body(link).xmat, atol=1e-8)
    for link in links:
        assert model.body(link).mass == urdf.body(link).mass
        place = {"mcp": 0, "mp": 0, "cmc": 0, "pip": 1, "ip": 1, "dip": 2}[link.split("_")[1]]
        added = model.body(link).inertia - urdf.body(link).inertia
        np.testing.assert_allclose(added, BODIES["twin"].armature[place], rtol=1e-6)
    for joint in JOINTS:
        np.testing.assert_allclose(model.joint(joint).range, urdf.joint(joint).range, atol=1e-8)


def test_mass_matrix_is_that_of_the_model():
    for body, name in (("twin", "hpac_hand.xml"), ("twin", "hpac_hand_on_wrist.xml")):
        model, data = loaded(name)
        synergy = 0.7 * HPAC.synergy_max
        set_joints(model, data, joints_from_synergy(synergy))
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full)
        ours = mass_matrix(GEOMETRY, BODIES[body].armature, synergy)
        np.testing.assert_allclose(
            ours, full[np.ix_(dofs(model), dofs(model))], rtol=1e-9, atol=1e-12
        )


@pytest.mark.parametrize("name", FILES)
def test_torques_at_rest_are_those_of_the_tendon_law(name):
    model, data = loaded(name)
    body, _ = FILES[name]
    law = Tendons(HPAC, np.eye(15), 1 / 120, BODIES[body].damping)
    rng = np.random.default_rng(1)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_GRAVITY
    for _ in range(20):
        synergy = HPAC.synergy_max * rng.uniform(0.1, 0.9, 6)
        angles = joints_from_synergy(synergy) + rng.uniform(-0.02, 0.02, 15)
        servo = servo_from_synergy(synergy) + rng.uniform(-5e-3, 5e-3, 6)
        data.ctrl[:6] = servo
        set_joints(model, data, angles)
        wanted, tension = law.torque(angles.tolist(), [0.0] * 15, servo.tolist(), [0.0] * 6)
        found = (data.qfrc_passive + data.qfrc_actuator)[dofs(model)]
        np.testing.assert_allclose(found, wanted, atol=2e-7)
        np.testing.assert_allclose(-data.actuator_force[:5], tension, atol=2e-5)
        assert min(tension) == 0.0 or max(tension) <= 40.0


def test_fingers_touch_all_but_fingers_and_no_link_its_parent():
    model, _ = loaded("hpac_hand.xml")
    excluded = {
        tuple(sorted((int(pair) >> 16, int(pair) & 0xFFFF))) for pair in model.exclude_signature
    }
    geoms = [index for index in range(model.ngeom) if model.geom_contype[index]]
    for first in geoms:
        for second in geoms:
            bodies = sorted((int(model.geom_bodyid[first]), int(model.geom_bodyid[second])))
            names = [model.body(body).name for body in bodies]
            if bodies[0] == bodies[1]:
                continue
            touch = bool(
                model.geom_contype[first] & model.geom_conaffinity[second]
                or model.geom_contype[second] & model.geom_conaffinity[first]
            )
            assert touch == (not all(name.split("_")[0] in FINGERS for name in names))
            if model.body_parentid[bodies[1]] == bodies[0] and names[0] == "palm":
                assert tuple(bodies) in excluded


@pytest.mark.parametrize("name", FILES)
def test_a_hand_in_a_viewer_closes_and_stays_calm(name):
    model, data = loaded(name)
    data.ctrl[:6] = 0.5 * servo_from_synergy(HPAC.synergy_max)
    for _ in range(600):
        mujoco.mj_step(model, data)
    assert data.warning.number.sum() == 0
    assert np.abs(data.qvel).max() < 0.02
    assert data.joint("index_mcp").qpos[0] > 0.4
