"""The hand's URDF and MJCF, as MuJoCo loads them, against the geometry, Table I, each other and the
tendon law.
"""

from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest

from hpac_gym.body.geometry import Capsule, link_poses, load_geometry
from hpac_gym.body.urdf import HAND_ON_WRIST_URDF, HAND_URDF, solid_inertia
from hpac_gym.model import FINGERS, HPAC, JOINTS, joints_from_synergy, servo_from_synergy
from hpac_gym.physics.mjcf import FILES
from hpac_gym.physics.settings import BODIES
from hpac_gym.physics.tendons import Tendons

ASSETS = Path(__file__).parents[2] / "assets"
GEOMETRY = load_geometry()
LINKS = [phalanx.link for phalanx in GEOMETRY.phalanges]


def loaded(name: str):
    folder = "urdf" if name.endswith("urdf") else "mjcf"
    model = mujoco.MjModel.from_xml_path(str(ASSETS / folder / name))
    return model, mujoco.MjData(model)


def dofs(model) -> list[int]:
    return [model.joint(name).dofadr[0] for name in JOINTS]


def set_joints(model, data, angles) -> None:
    for name, angle in zip(JOINTS, angles, strict=True):
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)


def posed(synergy):
    """The hand of the URDF at a synergy."""
    model, data = loaded(HAND_URDF)
    set_joints(model, data, joints_from_synergy(synergy))
    return model, data


def distance(model, data, link: str, other: int) -> float:
    """Distance of a link, which has one geom, from a body [m]; the palm is 0."""
    (geom,) = np.flatnonzero(model.geom_bodyid == model.body(link).id)
    others = np.flatnonzero(model.geom_bodyid == other)
    return min(mujoco.mj_geomDistance(model, data, geom, each, 0.5, None) for each in others)


def pad(data, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Place and normal of a digit's pad."""
    digit = GEOMETRY.digit(name)
    link = data.body(digit.phalanges[-1].link)
    rotation = link.xmat.reshape(3, 3)
    return link.xpos + rotation @ digit.pad, rotation @ digit.pad_normal


@pytest.mark.parametrize("name", [HAND_URDF, HAND_ON_WRIST_URDF, *FILES])
def test_joints_are_the_models_with_the_limits_of_table_1(name):
    model, _ = loaded(name)
    wrist = [f"wrist_{axis}" for axis in "xyz"] if "wrist" in name else []
    assert {model.joint(index).name for index in range(model.njnt)} == {*wrist, *JOINTS}
    limits = [model.joint(joint).range for joint in JOINTS]
    np.testing.assert_allclose(limits, np.stack([HPAC.joint_min, HPAC.joint_max], 1), atol=1e-8)
    assert not model.dof_frictionloss.any()
    if name.endswith("urdf"):
        assert not model.dof_damping.any(), "damping and friction belong to the tendons"


@pytest.mark.parametrize("name", [HAND_ON_WRIST_URDF, "hpac_hand_on_wrist.xml"])
def test_wrist_slides_along_x_y_z_by_a_metre_either_way(name):
    model, data = loaded(name)
    for axis, travel in zip("xyz", (0.1, 0.2, 0.3), strict=True):
        assert model.joint(f"wrist_{axis}").range.tolist() == [-1.0, 1.0]
        data.joint(f"wrist_{axis}").qpos[0] = travel
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.body("palm").xpos, (0.1, 0.2, 0.3), atol=1e-9)
    np.testing.assert_allclose(data.body("palm").xmat, np.eye(3).ravel(), atol=1e-9)


def test_bodies_of_both_files_are_those_of_the_geometry():
    model, data = loaded("hpac_hand_on_wrist.xml")
    urdf, other = loaded(HAND_ON_WRIST_URDF)
    rng = np.random.default_rng(0)
    for _ in range(5):
        angles = rng.uniform(HPAC.joint_min, HPAC.joint_max)
        set_joints(model, data, angles)
        set_joints(urdf, other, angles)
        for digit in GEOMETRY.digits:
            index = [JOINTS.index(phalanx.joint) for phalanx in digit.phalanges]
            poses = link_poses(digit, angles[index])
            for phalanx, (position, rotation) in zip(digit.phalanges, poses, strict=True):
                for found in (data.body(phalanx.link), other.body(phalanx.link)):
                    np.testing.assert_allclose(found.xpos, position, atol=1e-8)
                    np.testing.assert_allclose(found.xmat, rotation.ravel(), atol=1e-8)
    added = {"mcp": 0, "mp": 0, "cmc": 0, "pip": 1, "ip": 1, "dip": 2}
    for link in ("palm", *LINKS):
        assert model.body(link).mass == urdf.body(link).mass
        more = 0.0 if link == "palm" else BODIES["twin"].armature[added[link.split("_")[1]]]
        found = model.body(link).inertia - urdf.body(link).inertia
        np.testing.assert_allclose(found, more, rtol=1e-6, atol=1e-12)
    for part in ("wrist_x_link", "wrist_y_link"):
        np.testing.assert_allclose(2 * urdf.body(part).mass, model.body("wrist").mass)
        np.testing.assert_allclose(2 * urdf.body(part).inertia, model.body("wrist").inertia)


def test_inertia_of_a_capsule_is_that_of_a_sampled_one():
    capsule = Capsule((0.01, 0.0, 0.0), (0.01, 0.03, 0.04), 0.012)
    rng = np.random.default_rng(0)
    points = rng.uniform((-0.02, -0.02, -0.02), (0.04, 0.05, 0.06), (400_000, 3))
    start = np.array(capsule.start)
    axis = np.subtract(capsule.end, capsule.start)
    along = np.clip((points - start) @ axis / (axis @ axis), 0, 1)
    points = points[np.linalg.norm(points - start - along[:, None] * axis, axis=1) < capsule.radius]
    center, inertia = solid_inertia((capsule,), 0.01)
    offsets = points - points.mean(axis=0)
    sampled = 0.01 * (
        np.mean(np.sum(offsets**2, axis=1)) * np.eye(3) - offsets.T @ offsets / len(offsets)
    )
    np.testing.assert_allclose(center, points.mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(inertia, sampled, atol=0.01 * inertia.max())


def test_neighbouring_fingers_stand_five_degrees_apart():
    _, data = posed(np.zeros(6))
    directions = [data.body(f"{finger}_mcp_link").xmat[2::3] for finger in FINGERS]
    angles = [np.degrees(np.arccos(one @ other)) for one, other in pairwise(directions)]
    np.testing.assert_allclose(angles, 5.0, atol=1e-4)


@pytest.mark.parametrize("finger", FINGERS)
def test_thumb_touches_the_finger_pad_to_pad(finger):
    model, data = posed(GEOMETRY.opposition[finger])
    gap = distance(model, data, "thumb_ip_link", model.body(f"{finger}_dip_link").id)
    assert -3e-4 < gap < 5e-4
    pads, normals = zip(pad(data, "thumb"), pad(data, finger), strict=True)
    assert np.linalg.norm(pads[0] - pads[1]) < 2e-3
    assert np.degrees(np.arccos(-normals[0] @ normals[1])) < 40


def test_a_fist_closes_in_front_of_the_palm():
    model, data = posed([0.0, *HPAC.synergy_max[1:5], 0.0])
    for finger in FINGERS:
        tip, _ = pad(data, finger)
        base = GEOMETRY.digit(finger).phalanges[0].origin
        assert tip[0] > 0, "flexion goes out of the palm"
        assert tip[2] < base[2], "and folds back"
        assert distance(model, data, f"{finger}_dip_link", 0) > 0


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
