"""The hand in PyBullet: springs, friction and masses, and how it becomes another hand from episode
to episode.
"""

import dataclasses
import itertools
import os
import threading
from contextlib import closing

import numpy as np
import pytest

pytest.importorskip("pybullet")

import pybullet

from hpac_gym.errors import ParameterError
from hpac_gym.model import FINGERS, HPAC, JOINT_INDEX, joints_from_synergy, servo_from_synergy
from hpac_gym.physics.engine import Engine, SceneSetup
from hpac_gym.physics.pybullet.scene import Scene
from hpac_gym.physics.pybullet.world import quiet_output
from hpac_gym.physics.settings import BODIES, HandSettings, WorldSettings
from hpac_gym.physics.simulation import make_engine
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.grasp_any import GraspAny
from tests.physics.scenes import bits, close

FREE = WorldSettings(gravity=0.0, collisions=False)


@pytest.fixture
def scene():
    """A hand without weight that passes through everything."""
    made = Scene(FREE, False)
    made.reset(SceneSetup(None))
    yield made
    made.world.close()


@pytest.fixture
def opened(begun):
    """The joints 3 s after a hand is told to open, in free space, shape (15,) [deg]."""

    def joints(setup: SceneSetup) -> np.ndarray:
        simulation = begun("pybullet", setup, settings=FREE)
        simulation.command(servo_from_synergy(np.zeros(6))[None], 0.4)
        simulation.rest(3.0)
        return np.degrees(simulation.state().joint_pos[0])

    return joints


def test_the_hand_opens_by_its_springs(opened):
    assert opened(SceneSetup(None, synergy=0.9 * HPAC.synergy_max)).max() < 0.5


def test_output_comes_back_after_two_threads_silenced_it():
    """The first one is done before the second one."""
    before = [os.fstat(descriptor).st_ino for descriptor in (1, 2)]
    begun = threading.Event()
    first_is_done = threading.Event()

    def second() -> None:
        with quiet_output():
            begun.set()
            first_is_done.wait(5.0)

    other = threading.Thread(target=second)
    with quiet_output():
        other.start()
        assert not begun.wait(0.2)
    first_is_done.set()
    other.join()
    assert [os.fstat(descriptor).st_ino for descriptor in (1, 2)] == before


def test_joint_friction_holds_a_finger_that_is_let_go(opened):
    """10 mN·m of Coulomb friction in each joint stops it where the spring pulls less: 0.01/(k_s R
    ΣR q/q) = 0.3 rad.
    """
    setup = SceneSetup(
        None, synergy=0.5 * HPAC.synergy_max, hand_settings=HandSettings(joint_friction=0.01)
    )
    assert 5.0 < opened(setup)[JOINT_INDEX["index_mcp"]] < 17.0


def test_no_joint_has_a_motor(scene):
    """A pushed finger yields: with its drive slack only a spring holds it."""
    hand = scene.hand
    still = np.zeros((1, 6))
    for _ in range(120):
        link = hand.link_index["index_dip_link"]
        pybullet.applyExternalForce(
            hand.body, link, (0.3, 0, 0), (0, 0, 0.02), pybullet.LINK_FRAME, hand.world.client
        )
        scene.advance(still, still, np.zeros((1, 3)), None)
    bent, *_ = hand.state()
    assert bent[JOINT_INDEX["index_mcp"]] > 0.1
    assert abs(bent[JOINT_INDEX["middle_mcp"]]) < 1e-3


def test_every_link_has_the_friction_of_the_skin(scene):
    scene.reset(SceneSetup(None, hand_settings=HandSettings(contact_friction=0.37)))
    for link in scene.hand.link_index.values():
        assert pybullet.getDynamicsInfo(scene.hand.body, link, scene.world.client)[1] == 0.37


def test_fingers_do_not_reach_each_other(scene):
    """Why nobody has to check whether they touch: over the workspace they stay millimetres
    apart.
    """
    rng = np.random.default_rng(0)
    nearest = np.inf
    hand = scene.hand
    links = {
        finger: [index for name, index in hand.link_index.items() if name.startswith(finger)]
        for finger in FINGERS
    }
    for _ in range(60):
        share = rng.choice([0.0, 1.0, rng.uniform()], 6)
        hand.reset(share * HPAC.synergy_max)
        assert np.allclose(hand.state()[0], joints_from_synergy(share * HPAC.synergy_max))
        for one, other in itertools.combinations(FINGERS, 2):
            for pair in itertools.product(links[one], links[other]):
                near = pybullet.getClosestPoints(
                    hand.body, hand.body, 0.02, *pair, physicsClientId=scene.world.client
                )
                nearest = min([nearest, *(point[8] for point in near)])
    assert 0.002 < nearest < 0.02


def test_a_hand_becomes_another_one_and_is_loaded_anew_for_another_armature_or_after_many_episodes(
    scene, monkeypatch
):
    start = Grasp().setup(np.random.default_rng(0))
    scene.reset(start)
    first = scene.hand
    scene.reset(dataclasses.replace(start, hand_settings=HandSettings(contact_friction=0.3)))
    assert scene.hand is first
    assert scene.hand.settings.contact_friction == 0.3
    assert pybullet.getNumBodies(scene.world.client) == 4  # hand, object, post, table
    scene.reset(dataclasses.replace(start, hand_settings=HandSettings(armature=(4e-3, 2e-3, 1e-3))))
    assert scene.hand is not first
    monkeypatch.setattr("hpac_gym.physics.pybullet.scene._EPISODES", 3)
    hands = []
    for _ in range(7):
        scene.reset(start)
        hands.append(scene.hand)
    assert len({id(hand) for hand in hands}) == 3


def closed(setup: SceneSetup, engine: Engine) -> bytes:
    """The states of a world in which a hand closes."""
    engine.reset([0], [setup])
    return bits(close(engine, 7), 0)


def test_hands_of_two_orientations_stay_loaded_and_move_as_in_a_new_world():
    rng = np.random.default_rng(4)
    task = GraspAny()
    by_turn = {}
    while len(by_turn) < 2 or min(map(len, by_turn.values())) < 2:
        setup = task.setup(rng)
        by_turn.setdefault(setup.hand_quaternion, []).append(setup)
    one, other = by_turn.values()
    third = dataclasses.replace(one[0], hand_settings=HandSettings(armature=(4e-3, 2e-3, 1e-3)))
    fresh = {}
    with closing(make_engine("pybullet")) as kept:
        hands = []
        for setup in (one[0], other[0], one[1], other[1], third, one[0], other[0]):
            found = closed(setup, kept)
            hands.append(kept.scenes[0].hand)
            if id(setup) not in fresh:
                with closing(make_engine("pybullet")) as engine:
                    fresh[id(setup)] = closed(setup, engine)
            assert found == fresh[id(setup)]
    assert hands[2] is hands[0]
    assert hands[3] is hands[1]
    assert len({id(hand) for hand in hands}) == 5  # a third one takes the place of the oldest


def test_the_light_body_is_refused_with_what_to_do_instead():
    with pytest.raises(
        ParameterError, match=r'hub_inertia = 0.0013 kg m² must be 0 kg m².*engine="mujoco"'
    ):
        make_engine("pybullet").require(BODIES["light"])
