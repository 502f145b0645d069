"""One hand for many episodes: whatever was before, an episode is the same to the bit."""

import dataclasses
import hashlib
import itertools

import numpy as np
import pybullet
import pytest

from hpac_gym.envs import Grasp, GraspByName
from hpac_gym.model import FINGERS, HPAC, ServoCommand, joints_from_synergy, servo_from_synergy
from hpac_gym.sim import HandSettings, Scene, SceneSetup, SimHand, World

CLOSED = np.array([0.7, *HPAC.synergy_max[1:5], 1.2])
GRASP_NAMES = ("hook", "rod", "tweezers", "press")
"""In which fingers and thumb touch each other, and several things touch at once."""


def setup(name: str | None, seed: int) -> SceneSetup:
    task = Grasp() if name is None else GraspByName(name)
    return task.setup(np.random.default_rng(seed))


def trajectory(scene: Scene, start: SceneSetup, commands: int, seed: int) -> str:
    """A hash over every joint angle and object position of an episode of random commands near a closed hand."""
    rng, digest = np.random.default_rng(seed), hashlib.sha256()
    scene.reset(start)
    for step in range(commands):
        synergy = np.clip(CLOSED * min(1.0, step / 14) * rng.uniform(0.7, 1.0, 6), 0.0, HPAC.synergy_max)
        scene.advance(ServoCommand(servo_from_synergy(synergy), 0.05), Grasp().timetable.wrist_path)
        digest.update(scene.hand.joint_pos.tobytes())
        digest.update(scene.object_pose()[0].tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("name", [None, *GRASP_NAMES])
def test_an_episode_does_not_depend_on_those_before_it(name):
    rng = np.random.default_rng(0)
    used = Scene(visuals=False)
    for seed in range(8):
        fresh = Scene(visuals=False)
        expected = trajectory(fresh, setup(name, seed), 50, seed)
        fresh.close()
        for _ in range(2):
            other = int(rng.integers(1000, 2000))
            trajectory(used, setup(name, other), int(rng.integers(1, 50)), other)
            assert trajectory(used, setup(name, seed), 50, seed) == expected
    used.close()


def test_a_hand_becomes_another_one_and_is_loaded_anew_for_another_armature_or_after_many_episodes(monkeypatch):
    scene, start = Scene(visuals=False), setup(None, 0)
    scene.reset(start)
    first = scene.hand
    slippery = dataclasses.replace(start, hand_settings=HandSettings(contact_friction=0.3))
    scene.reset(slippery)
    assert scene.hand is first
    assert scene.hand.settings.contact_friction == 0.3
    assert pybullet.getNumBodies(scene.world.client) == 4  # hand, object, post, table
    heavy = HandSettings(armature=(4e-3, 2e-3, 1e-3))
    with pytest.raises(ValueError, match="armature"):
        first.configure(HPAC, heavy)
    scene.reset(dataclasses.replace(start, hand_settings=heavy))
    assert scene.hand is not first
    monkeypatch.setattr("hpac_gym.sim.stage.EPISODES", 3)
    hands = []
    for _ in range(7):
        scene.reset(start)
        hands.append(scene.hand)
    assert len({id(hand) for hand in hands}) == 3
    scene.close()


def test_fingers_do_not_reach_each_other():
    """Why nobody has to check whether they touch: over the workspace they stay millimetres apart."""
    rng, nearest = np.random.default_rng(0), np.inf
    with World() as world:
        hand = SimHand(world, visuals=False)
        links = {finger: [index for name, index in hand.link_index.items() if name.startswith(finger)] for finger in FINGERS}
        for _ in range(60):
            share = rng.choice([0.0, 1.0, rng.uniform()], 6)
            hand.reset(share * HPAC.synergy_max)
            assert np.allclose(hand.joint_pos, joints_from_synergy(share * HPAC.synergy_max))
            for one, other in itertools.combinations(FINGERS, 2):
                for pair in itertools.product(links[one], links[other]):
                    near = pybullet.getClosestPoints(hand.body, hand.body, 0.02, *pair, physicsClientId=world.client)
                    nearest = min([nearest, *(point[8] for point in near)])
    assert 0.002 < nearest < 0.02
