"""The hand's URDF against its geometry, Table I and the loaded body."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet")

import pybullet

from hpac_gym.body.geometry import Capsule, link_poses, load_geometry
from hpac_gym.body.urdf import (
    HAND_ON_WRIST_URDF,
    HAND_URDF,
    WRIST_SLIDE_MASS,
    WRIST_SLIDE_RADIUS,
    solid_inertia,
)
from hpac_gym.model import FINGERS, HPAC, JOINTS, joints_from_synergy

ROOT = Path(__file__).resolve().parents[2]
GEOMETRY = load_geometry()
URDFS = (HAND_URDF, HAND_ON_WRIST_URDF)


class Loaded:
    """The hand in its own client, as PyBullet understood the file."""

    def __init__(self, name: str) -> None:
        self.client = pybullet.connect(pybullet.DIRECT)
        self.body = pybullet.loadURDF(
            str(ROOT / "assets" / "urdf" / name),
            useFixedBase=True,
            flags=pybullet.URDF_USE_INERTIA_FROM_FILE,
            physicsClientId=self.client,
        )
        count = pybullet.getNumJoints(self.body, self.client)
        infos = [pybullet.getJointInfo(self.body, index, self.client) for index in range(count)]
        self.joints = {info[1].decode(): info for info in infos}
        self.links = {info[12].decode(): info[0] for info in self.joints.values()}
        self.links.setdefault("palm", -1)

    def pose(self, synergy) -> None:
        for name, angle in zip(JOINTS, joints_from_synergy(synergy), strict=True):
            pybullet.resetJointState(
                self.body, self.joints[name][0], angle, physicsClientId=self.client
            )

    def distance(self, link: str, other: str) -> float:
        points = pybullet.getClosestPoints(
            self.body,
            self.body,
            0.5,
            self.links[link],
            self.links[other],
            physicsClientId=self.client,
        )
        return min(point[8] for point in points)

    def dynamics(self, link: str) -> tuple:
        return pybullet.getDynamicsInfo(self.body, self.links[link], physicsClientId=self.client)


@pytest.fixture(params=URDFS)
def loaded(request):
    hand = Loaded(request.param)
    yield hand
    pybullet.disconnect(hand.client)


@pytest.fixture
def hand():
    hand = Loaded(HAND_URDF)
    yield hand
    pybullet.disconnect(hand.client)


def test_revolute_joints_are_the_models_with_the_limits_of_table_1(loaded):
    revolute = {
        name: info for name, info in loaded.joints.items() if info[2] == pybullet.JOINT_REVOLUTE
    }
    assert sorted(revolute) == sorted(JOINTS)
    np.testing.assert_allclose([revolute[name][8] for name in JOINTS], HPAC.joint_min, atol=1e-9)
    np.testing.assert_allclose([revolute[name][9] for name in JOINTS], HPAC.joint_max, atol=1e-9)
    assert {info[12].decode() for info in revolute.values()} == {f"{name}_link" for name in JOINTS}
    assert all(info[6] == 0 and info[7] == 0 for info in revolute.values()), (
        "damping and friction belong to the tendons"
    )


def test_wrist_slides_along_x_y_z_by_a_metre_either_way():
    hand = Loaded(HAND_ON_WRIST_URDF)
    slides = [hand.joints[f"wrist_{axis}"] for axis in "xyz"]
    assert [info[2] for info in slides] == [pybullet.JOINT_PRISMATIC] * 3
    assert [info[8:10] for info in slides] == [(-1.0, 1.0)] * 3
    for info, travel in zip(slides, (0.1, 0.2, 0.3), strict=True):
        pybullet.resetJointState(hand.body, info[0], travel, physicsClientId=hand.client)
    position, rotation = _frame(hand, "palm")
    pybullet.disconnect(hand.client)
    np.testing.assert_allclose(position, (0.1, 0.2, 0.3), atol=1e-9)
    np.testing.assert_allclose(rotation, np.eye(3), atol=1e-9)


def test_loaded_masses_and_inertias_are_those_of_the_solids(loaded):
    slide = (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), WRIST_SLIDE_RADIUS),), WRIST_SLIDE_MASS
    bodies = {phalanx.link: ((phalanx.capsule,), phalanx.mass) for phalanx in GEOMETRY.phalanges}
    bodies |= {
        "palm": (GEOMETRY.palm_solids, GEOMETRY.palm_mass),
        "wrist_x_link": slide,
        "wrist_y_link": slide,
    }
    assert set(loaded.links) <= set(bodies)
    for link in (link for link, index in loaded.links.items() if index >= 0):
        solids, mass = bodies[link]
        center, inertia = solid_inertia(solids, mass)
        dynamics = loaded.dynamics(link)
        assert dynamics[0] == pytest.approx(mass), link
        np.testing.assert_allclose(
            sorted(dynamics[2]), np.linalg.eigvalsh(inertia), rtol=1e-6, err_msg=link
        )
        np.testing.assert_allclose(dynamics[3], center, atol=1e-9, err_msg=link)


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


def test_neighbouring_fingers_stand_five_degrees_apart(hand):
    straight = [hand.joints[f"{finger}_mcp"] for finger in FINGERS]
    directions = [
        np.array(pybullet.getMatrixFromQuaternion(info[15])).reshape(3, 3)[:, 2]
        for info in straight
    ]
    angles = [np.degrees(np.arccos(one @ other)) for one, other in pairwise(directions)]
    # PyBullet tells a joint's frame relative to the palm's principal axes, so only the angles
    # between fingers mean something.
    np.testing.assert_allclose(angles, 5.0, atol=1e-4)


@pytest.mark.parametrize("finger", FINGERS)
def test_thumb_touches_the_finger_pad_to_pad(hand, finger):
    hand.pose(GEOMETRY.opposition[finger])
    gap = hand.distance("thumb_ip_link", f"{finger}_dip_link")
    assert -3e-4 < gap < 5e-4
    pads, normals = zip(*(_pad(hand, name) for name in ("thumb", finger)), strict=True)
    assert np.linalg.norm(pads[0] - pads[1]) < 2e-3
    assert np.degrees(np.arccos(-normals[0] @ normals[1])) < 40


def test_own_kinematics_are_those_of_the_loaded_body(hand):
    synergy = 0.6 * HPAC.synergy_max
    hand.pose(synergy)
    angles = dict(zip(JOINTS, joints_from_synergy(synergy), strict=True))
    for digit in GEOMETRY.digits:
        poses = link_poses(digit, np.array([angles[phalanx.joint] for phalanx in digit.phalanges]))
        for phalanx, (position, rotation) in zip(digit.phalanges, poses, strict=True):
            seen = _frame(hand, phalanx.link)
            np.testing.assert_allclose(position, seen[0], atol=1e-6)
            np.testing.assert_allclose(rotation, seen[1], atol=1e-6)


def test_a_fist_closes_in_front_of_the_palm(hand):
    hand.pose([0.0, *HPAC.synergy_max[1:5], 0.0])
    for finger in FINGERS:
        tip, _ = _pad(hand, finger)
        base = GEOMETRY.digit(finger).phalanges[0].origin
        assert tip[0] > 0, "flexion goes out of the palm"
        assert tip[2] < base[2], "and folds back"
        assert hand.distance(f"{finger}_dip_link", "palm") > 0


def _frame(hand: Loaded, link: str) -> tuple[np.ndarray, np.ndarray]:
    state = pybullet.getLinkState(
        hand.body, hand.links[link], computeForwardKinematics=1, physicsClientId=hand.client
    )
    return np.array(state[4]), np.array(pybullet.getMatrixFromQuaternion(state[5])).reshape(3, 3)


def _pad(hand: Loaded, name: str) -> tuple[np.ndarray, np.ndarray]:
    digit = GEOMETRY.digit(name)
    position, rotation = _frame(hand, digit.phalanges[-1].link)
    return position + rotation @ digit.pad, rotation @ digit.pad_normal
