"""What the camera sees past the hand, and what the servos tell."""

from dataclasses import replace

import numpy as np
import pytest

from hpac_gym.body.geometry import HPAC_GEOMETRY as GEOMETRY, link_poses, rotation_from_rpy
from hpac_gym.body.hands import hand_set
from hpac_gym.body.object_models import Solid, load_object_models
from hpac_gym.body.object_sets import object_set
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.model import HPAC, JOINTS
from hpac_gym.physics.engine import SceneSetup, SceneState, Viewpoint
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.occlusion import SKIN, Skeleton, covered, inside, surface
from hpac_gym.tasks.senses import POINTS, VIEW_TARGET, Senses, ServoSenses, eye_offset

FRONT = Viewpoint(distance=0.4, yaw_deg=180.0, pitch_deg=0.0)
"""In front of the palm of a hand in its usual orientation."""


def test_the_skeleton_is_where_forward_kinematics_puts_the_links():
    rng = np.random.default_rng(0)
    joint_pos = rng.uniform(0, 1.5, (4, len(JOINTS)))
    bodies = [GEOMETRY, hand_set("train")[3].geometry, GEOMETRY, hand_set("test")[0].geometry]
    skeleton = Skeleton(4)
    for world, body in enumerate(bodies):
        skeleton.fit(world, body)
    first, second = skeleton.segments(joint_pos, np.arange(4))
    for world, (angles, body) in enumerate(zip(joint_pos, bodies, strict=True)):
        expected = []
        for digit in body.digits:
            own = np.array([angles[JOINTS.index(phalanx.joint)] for phalanx in digit.phalanges])
            for phalanx, (place, rotation) in zip(
                digit.phalanges, link_poses(digit, own), strict=True
            ):
                expected.append((place, place + rotation @ phalanx.capsule.end))
        np.testing.assert_allclose(first[world, :15], [start for start, _ in expected], atol=1e-12)
        np.testing.assert_allclose(second[world, :15], [end for _, end in expected], atol=1e-12)


def test_the_palm_s_capsules_fill_its_box():
    first, second = Skeleton(1).segments(np.zeros((1, len(JOINTS))), np.array([0]))
    box = GEOMETRY.palm_solids[0]
    places = np.random.default_rng(1).uniform(-0.3, 0.3, (200, 3)) * box.size + box.center
    aside = np.array([0.2, 0.0, 0.0])
    radius = Skeleton(1).radius
    asked = np.ones((1, 1), dtype=bool)
    hidden = [
        covered((point - aside)[None], (point + aside)[None, None], asked, first, second, radius)
        for point in places
    ]
    assert np.mean(hidden) > 0.97


def test_a_capsule_covers_what_is_behind_it_and_nothing_else():
    """Against points along the ray, sampled one by one."""
    rng = np.random.default_rng(2)
    eye = rng.uniform(-1, 1, (3, 3))
    points = rng.uniform(-1, 1, (3, 40, 3))
    first = rng.uniform(-1, 1, (3, 5, 3))
    second = rng.uniform(-1, 1, (3, 5, 3))
    radius = np.full((3, 5), 0.3)
    asked = rng.random((3, 40)) < 0.9
    found = covered(eye, points, asked, first, second, radius)
    way = np.linspace(0, 1, 200)[:, None]
    along = np.linspace(0, 1, 60)[:, None, None]
    for world, index in np.ndindex(3, 40):
        bones = (first[world] + along * (second[world] - first[world])).reshape(-1, 3)
        ray = eye[world] + way * (points[world, index] - eye[world])
        nearest = np.sqrt(((ray[:, None] - bones) ** 2).sum(axis=2).min())
        if abs(nearest - SKIN * 0.3) > 0.02:
            assert found[world, index] == (asked[world, index] and nearest < SKIN * 0.3)
    assert 0.1 < found.mean() < 0.9


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere", "capsule"])
def test_points_of_a_surface_lie_on_it_are_spread_evenly_and_reach_its_bounds(kind):
    size = {"box": (0.02, 0.04, 0.06), "sphere": (0.04, 0.04, 0.04)}.get(kind, (0.03, 0.03, 0.08))
    turn = rotation_from_rpy((0.4, -1.1, 2.3))
    solid = Solid(kind, 1.0, size, np.array([0.01, 0.0, 0.0]), turn)
    points, normals = surface(kind, (solid,), 2000)
    low, high = solid.bounds
    assert ((points >= low - 1e-12) & (points <= high + 1e-12)).all()
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], [low, high], atol=2e-3)
    half = np.array(size) / 2
    own = (points - solid.center) @ turn
    normals = normals @ turn
    if kind == "box":
        np.testing.assert_allclose(np.abs(own / half).max(axis=1), 1.0)
    elif kind == "cylinder":
        np.testing.assert_allclose(
            np.maximum(np.hypot(*own.T[:2]) / half[0], np.abs(own[:, 2]) / half[2]), 1.0
        )
    else:
        core = own - np.clip(own, [0, 0, half[0] - half[2]], [0, 0, half[2] - half[0]]) * [0, 0, 1]
        np.testing.assert_allclose(np.linalg.norm(core, axis=1), half[0])
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert ((own * normals).sum(axis=1) > 0).all()
    # A closed surface's normals cancel out.
    np.testing.assert_allclose(normals.mean(axis=0), 0.0, atol=0.05)


def test_fewer_points_of_a_surface_are_the_first_ones():
    model = load_object_models()["spray_can"]
    few = surface("spray_can", model.solids, 48)
    for some, more in zip(few, surface("spray_can", model.solids, 160), strict=True):
        np.testing.assert_array_equal(some, more[:48])


def test_points_of_all_objects_of_a_split_are_kept():
    """Drawing them anew cost a tenth of a training with more objects than were kept."""
    splits = map(object_set, ("train", "wide", "test", "real"))
    assert max(map(len, splits)) <= surface.cache_parameters()["maxsize"]


def test_no_point_of_a_surface_is_inside_another_solid():
    model = load_object_models()["spray_can"]
    points, _ = surface("spray_can", model.solids, 500)
    for solid in model.solids:
        core = replace(solid, size=tuple(0.99 * side for side in solid.size))
        assert not inside(core, points).any()


def ball(depth: float, beyond: float = 0.12) -> SceneSetup:
    """A ball at a distance from the palm, and at a distance from the wrist along the fingers
    [m].
    """
    spec = ObjectSpec("sphere", (0.02, 0.02, 0.02), 0.1, 0.7)
    return SceneSetup(spec, position=np.array([depth, 0.0, beyond]))


def state_of(setup: SceneSetup, *joint_pos: np.ndarray) -> SceneState:
    """A state with a world for each hand."""
    state = SceneState.empty(len(joint_pos))
    state.joint_pos[:] = joint_pos
    state.object_pos[:] = setup.position
    state.object_rotation[:] = setup.hand_rotation.T
    return state


def senses(setup: SceneSetup, **options) -> Senses:
    made = Senses(1, CameraNoise(0, 0, 0), FRONT, points=True, **options)
    made.start(0, setup, 1.0, np.random.default_rng(0))
    return made


OPEN = np.zeros(len(JOINTS))
FIST = np.minimum(HPAC.joint_max, 1.2)


def test_a_fist_in_front_of_the_ball_hides_it_but_in_the_first_look_and_the_last_one_stays():
    setup = ball(0.06)
    behind = ball(0.03, 0.085)
    seen = senses(behind).look(state_of(behind, FIST), [0])  # the hand is not there yet
    assert seen["visible"][0] == 0
    np.testing.assert_allclose(seen["position"][0], behind.position)
    eyes = senses(setup)
    seen = eyes.look(state_of(setup, OPEN), [0])
    np.testing.assert_allclose(seen["position"][0], setup.position)
    assert seen["visible"][0] == 1
    seen = eyes.look(state_of(behind, FIST), [0])
    assert seen["visible"][0] == 0
    np.testing.assert_allclose(seen["position"][0], setup.position)
    assert not eyes.points(state_of(behind, FIST))[0, :, 3].all()
    seen = eyes.look(state_of(behind, OPEN), [0])
    assert seen["visible"][0] == 1
    np.testing.assert_allclose(seen["position"][0], behind.position)


def test_the_order_in_which_worlds_are_named_is_none_of_their_looks():
    behind = ball(0.03, 0.085)
    for order in ([0, 1], [1, 0]):
        eyes = Senses(2, CameraNoise(0, 0, 0), FRONT)
        for world in order:
            eyes.start(world, behind, 1.0, np.random.default_rng(0))
        seen = eyes.look(state_of(behind, OPEN, FIST), order)
        np.testing.assert_array_equal(seen["visible"], [1, 0])


def test_points_are_of_the_camera_s_side():
    setup = ball(0.06)
    eyes = senses(setup)
    eyes.look(state_of(setup, OPEN), [0])
    points = eyes.points(state_of(setup, OPEN))[0]
    assert points.shape == (POINTS, 4)
    assert (points[:, 3] == 1).sum() > 50
    places = points[points[:, 3] == 1, :3] * 0.05 + [0.045, 0.005, 0.1125]
    np.testing.assert_allclose(np.linalg.norm(places - setup.position, axis=1), 0.02, atol=1e-6)
    towards = VIEW_TARGET + setup.hand_rotation.T @ eye_offset(FRONT) - setup.position
    assert ((places - setup.position) @ towards > 0).all()
    assert (points[points[:, 3] == 0] == 0).all()


def test_a_servo_tells_its_load_in_steps_now_and_then_with_its_error():
    setup = ball(0.06)
    servos = ServoSenses(load_noise=0.0, load_bias=0.0)
    eyes = senses(setup, servos=servos)
    state = state_of(setup, OPEN)
    told = []
    for step in range(4):
        state.tension[:] = 5.0 * (step + 1)
        state.horn[:] = -0.3  # slack tendons, which hold no horn back
        told.append(eyes.look(state, [0]))
    exact = 5.0 * HPAC.servo_radius[:5] / servos.stall_torque
    np.testing.assert_allclose(told[0]["load"][0], exact, atol=servos.load_step / 2)
    np.testing.assert_array_equal(told[1]["load"], told[0]["load"])  # ten readings a second
    np.testing.assert_allclose(told[2]["load"][0], 3 * exact, atol=servos.load_step / 2)
    steps = told[2]["load"] / servos.load_step
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    np.testing.assert_allclose(told[0]["horn"], -0.3, atol=servos.horn_step / 2)
    wrong = [senses(setup, servos=ServoSenses(load_noise=0.0)) for _ in range(2)]
    first, second = (eyes.look(state, [0])["load"] for eyes in wrong)
    np.testing.assert_array_equal(first, second)
    assert np.abs(first[0] - 4 * exact).max() > 0.01


def test_a_horn_stays_behind_by_its_servos_share_of_the_stretch_and_by_all_beyond_its_stall():
    setup = ball(0.06)
    state = state_of(setup, OPEN)
    digit = HPAC.digits["index"]
    radius = digit.servo_radius
    stall = digit.tension_limit / digit.drive_stiffness
    for stretch, behind in (
        (-1e-4, 0.0),  # slack
        (0.5 * stall, 0.5 * digit.tension_limit * radius / 24.0),
        (stall + 1e-3, digit.tension_limit * radius / 24.0 + 1e-3 / radius),
    ):
        eyes = senses(setup, servos=ServoSenses(horn_step=1e-9))
        state.horn[0, 1] = stretch / radius  # the finger is held straight
        told = eyes.look(state, [0])["horn"][0]
        assert told[1] == pytest.approx(stretch / radius - behind, abs=1e-8)


def test_a_servo_is_not_softer_than_its_whole_drive():
    for digit in HPAC.digits.values():
        whole = digit.drive_stiffness * digit.servo_radius**2
        assert 1 / ServoSenses().stiffness < 1 / whole
