"""The objects of the named grasps: their files against the data, and the data against what its
sources print.
"""

import dataclasses
import itertools
from collections.abc import Sequence
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("pybullet")

import pybullet

from hpac_gym.body.object_models import ObjectModel, load_object_models
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs.randomization import PRESETS, changed_setup
from hpac_gym.physics.pybullet.objects import SimObject, add_fixed_box
from hpac_gym.physics.pybullet.scene import Scene
from hpac_gym.physics.pybullet.world import World
from hpac_gym.physics.settings import WorldSettings
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.grasp_data import GRASPS, NOMINAL, quaternion_from_rpy

MODELS = load_object_models()


@pytest.mark.parametrize("model", MODELS.values(), ids=list(MODELS))
def test_a_loaded_object_has_its_mass_its_inertia_and_its_size(model: ObjectModel):
    scale = 1.1
    mass = 1.3 * model.mass
    spec = ObjectSpec(
        model.shape,
        tuple(scale * half for half in model.half_extents),
        mass,
        0.5,
        model.name,
        scale,
    )
    with closing(World()) as world:
        item = SimObject(world, spec, (0.1, 0.2, 0.3), quaternion_from_rpy((0.3, 0.2, 0.1)))
        loaded = pybullet.getDynamicsInfo(item.body, -1, world.client)
        assert loaded[0] == pytest.approx(mass)
        assert loaded[1] == pytest.approx(0.5)
        principal = np.linalg.eigvalsh(model.inertia) * 1.3 * scale**2
        np.testing.assert_allclose(sorted(loaded[2]), principal, rtol=1e-5)
        position, _ = item.pose()
        np.testing.assert_allclose(position, (0.1, 0.2, 0.3), atol=1e-6)
        item = SimObject(world, spec, (0, 0, 0))
        (low, high) = model.turned_bounds(np.eye(3))
        extents = [
            reach(world, item, direction) + reach(world, item, -direction)
            for direction in np.eye(3)
        ]
        np.testing.assert_allclose(extents, scale * (high - low), atol=1e-3)  # Bullet rounds edges


def reach(world: World, item: SimObject, direction: np.ndarray) -> float:
    """How far an object at the origin reaches, by its distance from a wall [m]."""
    wall = add_fixed_box(world, (0.5, 0.5, 0.5), 0.8 * direction, (1, 1, 1, 1))
    found = pybullet.getClosestPoints(wall, item.body, 1.0, physicsClientId=world.client)
    pybullet.removeBody(wall, physicsClientId=world.client)
    return 0.3 - min(point[8] for point in found)


def test_hollow_solids_have_the_inertia_of_shells():
    ball = MODELS["tennis_ball"]
    tube = MODELS["relay_baton"]
    radius = 0.0335
    shell = 2 / 3 * ball.mass * 0.0335**2
    assert 0.75 * shell < ball.inertia[0, 0] < shell
    assert ball.inertia[0, 0] > 2 / 5 * ball.mass * radius**2
    assert tube.inertia[2, 2] == pytest.approx(tube.mass * 0.0195**2, rel=0.01)


def test_a_hexagonal_bar_has_the_inertia_of_a_solid_one():
    puck = MODELS["hexagonal_puck"]
    side = 0.0340 * 2 / np.sqrt(3)
    assert puck.inertia[2, 2] == pytest.approx(5 / 12 * puck.mass * side**2, rel=0.02)
    assert puck.inertia[0, 0] == pytest.approx(puck.inertia[1, 1])


@pytest.fixture(scope="module")
def scene():
    made = Scene(WorldSettings(), False)
    yield made
    made.world.close()


def overlap(scene: Scene, others: Sequence[int]) -> float:
    """How deep the hand is inside of the object, or either of them inside of other bodies [m]."""
    hand = scene.hand.body
    item = scene.object.body
    client = scene.world.client
    pairs = [(hand, item), *((body, other) for body in (hand, item) for other in others)]
    near = [
        point
        for pair in pairs
        for point in pybullet.getClosestPoints(*pair, 0.0, physicsClientId=client)
    ]
    return max((-point[8] for point in near), default=0.0)


def supports(scene: Scene) -> list[int]:
    """Every body of the scene besides the hand and the object."""
    client = scene.world.client
    bodies = [
        pybullet.getBodyUniqueId(index, client) for index in range(pybullet.getNumBodies(client))
    ]
    return [body for body in bodies if body not in (scene.hand.body, scene.object.body)]


@pytest.mark.parametrize("variant", [NOMINAL, "large", "small", "shape"])
@pytest.mark.parametrize("name", GRASPS)
def test_at_no_corner_of_the_noise_anything_starts_inside_of_anything(
    name: str, variant: str, scene
):
    """The object may touch its support, and walls the object; nothing is deeper than 0.1 mm.

    The half of the sixteen corners in which every combination of three signs occurs.
    """
    task = Grasp(grasp=name, variant=variant)
    grasp = task.grasp
    middle = task.setup(np.random.default_rng(0))
    for corner in ((x, y, z, x * y * z) for x, y, z in itertools.product((-1, 1), repeat=3)):
        position = grasp.position + np.array(corner[:3]) * grasp.position_noise
        scene.reset(dataclasses.replace(middle, position=position, yaw=corner[3] * grasp.yaw_noise))
        assert overlap(scene, supports(scene)) < 1e-4, f"at the corner {corner}"


@pytest.mark.parametrize("name", GRASPS)
def test_no_randomized_episode_starts_inside_of_the_hand(name: str, scene):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        setup = Grasp(grasp=name).setup(rng)
        scene.reset(changed_setup(setup, PRESETS["full"].draw(rng)))
        assert overlap(scene, ()) < 2e-4, f"with the seed {seed}"
