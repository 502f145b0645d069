"""The family of hands: what is drawn, and what both engines make of it."""

import dataclasses
import warnings
from functools import partial

import mujoco
import numpy as np
import pytest

from experiments.conformance import free_space, stiffest_mode
from hpac_gym.body.geometry import HPAC_GEOMETRY
from hpac_gym.body.hands import SERVO_ZERO, SIZES, HandVariant, hand_set
from hpac_gym.errors import ParameterError
from hpac_gym.model import (
    DIGITS,
    HPAC,
    JOINT_INDEX,
    JOINTS,
    SERVOS,
    joints_from_synergy,
    servo_from_synergy,
    synergy_from_servo,
)
from hpac_gym.model.variation import scaled_hand
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.mechanics import mass_matrix
from hpac_gym.physics.mujoco.engine import MuJoCoEngine
from hpac_gym.physics.settings import BODIES, HandSettings, WorldSettings
from hpac_gym.physics.simulation import ENGINES, SET_UPS, make_engine
from hpac_gym.tasks.grasp import Grasp

ALL = hand_set("train") + hand_set("test")
NOMINAL = HandVariant("nominal", HPAC, HPAC_GEOMETRY, (0.0,) * 5, (0.0,) * 6, (1.0,) * 5)
EVERY = (NOMINAL, *ALL)
CLOSED = np.array([0.7, *HPAC.synergy_max[1:5], 1.2])
ROOTS = [JOINT_INDEX[name] for name in SERVOS]

engines = pytest.mark.parametrize("engine", ENGINES)


def empty(variant: HandVariant, cmc: float = 0.0) -> SceneSetup:
    """One of the hands alone, open, with a CMC angle [rad]."""
    opened = np.array([0.0, 0.0, 0.0, 0.0, 0.0, cmc])
    settings = variant.over(BODIES["twin"])
    return SceneSetup(
        None, synergy=opened, hand=variant.hand, geometry=variant.geometry, hand_settings=settings
    )


def test_the_sets_are_as_large_and_as_broken_as_stated_and_share_no_hand():
    assert {name: len(hand_set(name)) for name in SIZES} == SIZES == {"train": 32, "test": 8}
    assert (
        len({variant.name for variant in ALL}) == len({variant.geometry for variant in ALL}) == 40
    )
    assert hand_set.__wrapped__("test") == hand_set("test")
    for name, count in SIZES.items():
        weakest = np.array([min(variant.strength) for variant in hand_set(name)])
        assert ((weakest > 0) & (weakest < 1)).sum() == count / 4
        assert (weakest == 0).sum() == count / 8
    slack = np.array([variant.slack for variant in ALL])
    assert 0 <= slack.min() < 3e-4
    assert 2.7e-3 < slack.max() <= 3e-3
    zero = np.abs([variant.servo_zero for variant in ALL])
    assert 0.9 * SERVO_ZERO < zero.max() <= SERVO_ZERO
    with pytest.raises(ParameterError, match="hand set 'held_out' is not one of train, test"):
        hand_set("held_out")


def test_lengths_paths_and_pulleys_scale_together():
    for variant in ALL:
        for digit, nominal in zip(variant.geometry.digits, HPAC_GEOMETRY.digits, strict=True):
            lengths = np.array(
                [
                    link.length / old.length
                    for link, old in zip(digit.phalanges, nominal.phalanges, strict=True)
                ]
            )
            assert (np.abs(lengths - 1) < 0.2).all()
            tendon = variant.hand.digits[digit.name]
            old = HPAC.digits[digit.name]
            paths = np.array(tendon.path_length) / old.path_length
            np.testing.assert_allclose(
                paths, lengths[1:2] if digit.name == "thumb" else lengths[:2]
            )
            np.testing.assert_allclose(tendon.rigid_ratio, old.rigid_ratio)
            assert np.linalg.norm(digit.pad) > np.linalg.norm(nominal.pad) * 0.8


def test_no_hand_leaves_table_1_or_is_too_stiff_for_the_explicit_engine():
    for variant in ALL:
        hand = variant.hand
        np.testing.assert_array_equal(hand.joint_max, HPAC.joint_max)
        assert (hand.elastic_ratio * hand.synergy_max[hand.servo_of_joint] <= hand.joint_max).all()
        assert stiffest_mode(BODIES["twin"], WorldSettings(), hand, variant.geometry) < 1.5


@pytest.fixture(scope="module")
def every_hand():
    """All hands in one batch, after every world but the middle one had another hand before."""
    engine = MuJoCoEngine(len(EVERY))
    for hands in (reversed(EVERY), EVERY):
        engine.reset(range(len(EVERY)), [empty(variant) for variant in hands])
    return engine


def test_mujoco_loads_the_links_of_every_hand(every_hand):
    assert len(every_hand._groups) == 1
    for world, variant in enumerate(EVERY):
        model, data = every_hand.single(world)
        for phalanx in variant.geometry.phalanges:
            link = model.body(phalanx.link)
            geom = model.geom(phalanx.link)
            (_, _, end) = phalanx.capsule.end
            np.testing.assert_allclose(link.mass, phalanx.mass, rtol=1e-8)
            np.testing.assert_allclose(link.pos, phalanx.origin, atol=1e-9)
            np.testing.assert_allclose(geom.size[:2], [phalanx.capsule.radius, end / 2], rtol=1e-8)
            np.testing.assert_allclose(geom.pos, [0, 0, end / 2], atol=1e-10)
        chords = [model.tendon_length0[model.tendon(f"{digit}_drive").id] for digit in DIGITS]
        np.testing.assert_allclose(chords, variant.hand.rest_chord, rtol=1e-8)
        full = np.zeros((model.nv, model.nv))
        joints = [model.joint(name) for name in JOINTS]
        synergy = 0.7 * variant.hand.synergy_max
        for joint, angle in zip(joints, joints_from_synergy(synergy, variant.hand), strict=True):
            data.qpos[joint.qposadr[0]] = angle
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        dofs = [joint.dofadr[0] for joint in joints]
        wanted = mass_matrix(variant.geometry, BODIES["twin"].armature, synergy, variant.hand)
        np.testing.assert_allclose(full[np.ix_(dofs, dofs)], wanted, rtol=1e-7, atol=1e-11)


@pytest.mark.pybullet
@pytest.mark.parametrize("variant", [ALL[0], ALL[13], ALL[35]], ids=lambda variant: variant.name)
def test_pybullet_loads_the_links_of_a_hand(variant, begun):
    import pybullet

    engine = begun("pybullet", empty(ALL[5])).engine
    engine.reset([0], [empty(variant)])
    hand = engine.scenes[0].hand
    client = engine.scenes[0].world.client
    for phalanx in variant.geometry.phalanges:
        index = hand.link_index[phalanx.link]
        (_, _, end) = phalanx.capsule.end
        mass, *_ = pybullet.getDynamicsInfo(hand.body, index, client)
        assert mass == pytest.approx(phalanx.mass, rel=1e-6)
        shape = pybullet.getCollisionShapeData(hand.body, index, client)[0]
        assert shape[3][:2] == pytest.approx((end, phalanx.capsule.radius), rel=1e-6)
        if phalanx.parent != "palm":
            frame = np.array(pybullet.getJointInfo(hand.body, index, client)[14])
            parent = next(
                link for link in variant.geometry.phalanges if link.link == phalanx.parent
            )
            # From the parent's middle.
            assert frame[2] == pytest.approx(parent.length - parent.capsule.end[2] / 2, rel=1e-6)


def test_no_hand_touches_itself_at_the_start_wherever_the_thumb_is(every_hand):
    for cmc in np.linspace(0.0, HPAC.synergy_max[-1], 8):
        every_hand.reset(range(len(EVERY)), [empty(variant, cmc) for variant in EVERY])
        for world, variant in enumerate(EVERY):
            _, data = every_hand.single(world)
            assert data.ncon == 0, f"{variant.name} with CMC at {cmc:.2f} rad"


@pytest.mark.parametrize(("engine", "body"), [set_up.split("/") for set_up in SET_UPS])
@pytest.mark.parametrize("variant", [ALL[26], ALL[36]], ids=lambda variant: variant.name)
def test_free_space_keeps_to_equations_12_and_13_of_the_hand_itself(engine, body, variant):
    make = partial(make_engine, engine)
    manifold, command, speed = free_space(
        make, BODIES[body], WorldSettings(), 3, 0, variant.hand, variant.geometry
    )
    assert manifold < 1e-3
    assert command < 0.4  # the drives are softer than the nominal one's
    assert speed < 0.05
    # Another hand's law would be seen.
    assert np.abs(HPAC.elastic_ratio - variant.hand.elastic_ratio).max() > 4e-3


@pytest.mark.parametrize(("engine", "body"), [set_up.split("/") for set_up in SET_UPS])
def test_a_drive_of_any_stiffness_moves_as_the_stiffest_that_is_simulated(engine, body):
    """A hand file from a sweep may have a drive of 10⁹ N/m, whose stretch was not seen."""
    rigid = scaled_hand(HPAC, {"drive_stiffness": 1e4})
    world = WorldSettings()
    make = partial(make_engine, engine)
    manifold, command, speed = free_space(make, BODIES[body], world, 3, 0, rigid, HPAC_GEOMETRY)
    assert manifold < 1e-3
    assert command < 0.3
    assert speed < 0.05


@pytest.mark.pybullet
@pytest.mark.parametrize(("factor", "shivers"), [(1.3, False), (1.5, True)])
def test_pybullet_warns_of_tendons_that_are_too_stiff_for_it(factor, shivers, begun):
    stiff = scaled_hand(HPAC, {"tendon_stiffness": factor, "drive_stiffness": factor})
    half = HPAC.synergy_max / 2
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        simulation = begun("pybullet", SceneSetup(None, synergy=half, hand=stiff))
    assert len(told) == shivers
    simulation.command(servo_from_synergy(half * 1.2)[None], 0.5)
    simulation.rest(1.5)
    assert (abs(simulation.state().joint_vel).max() > 1.0) == shivers
    if told:
        assert "ω dt of the hand's stiffest tendon is 1.46: above 1.4" in f"{told[0].message}"


@engines
def test_a_dead_digit_does_not_pull_a_weak_one_pulls_its_share_and_a_servo_zero_moves_the_hand(
    engine, begun
):
    """Closing on a can; the fourth hand is empty, and its servos' commands know nothing of their
    zeros.
    """
    zero = (0.0, 0.05, -0.03, 0.04, 0.0, -0.05)
    plain = Grasp().setup(np.random.default_rng(0))
    empty = SceneSetup(None, synergy=np.array([0.3, 0.4, 0.5, 0.4, 0.3, 0.6]))
    broken = [
        HandSettings(),
        HandSettings(strength=(1.0, 1.0, 0.0, 1.0, 1.0)),
        HandSettings(strength=(1.0, 1.0, 0.4, 1.0, 1.0)),
    ]
    starts = [dataclasses.replace(plain, hand_settings=settings) for settings in broken]
    shifted = dataclasses.replace(empty, hand_settings=HandSettings(servo_zero=zero))
    simulation = begun(engine, *starts, shifted)
    first = simulation.state()
    servo = servo_from_synergy(empty.synergy)
    np.testing.assert_allclose(first.horn[3], servo + zero)
    np.testing.assert_allclose(
        first.joint_pos[3, ROOTS], synergy_from_servo(servo + zero), atol=1e-9
    )
    command = np.tile(servo_from_synergy(CLOSED), (4, 1))
    command[3] = servo_from_synergy(empty.synergy * 1.2)
    simulation.command(command, 0.5)
    simulation.rest(1.5)
    state = simulation.state()
    np.testing.assert_allclose(
        state.joint_pos[3, ROOTS], synergy_from_servo(command[3] + zero), atol=6e-3
    )
    middle = DIGITS.index("middle")
    assert state.tension[0].max() == pytest.approx(40.0, abs=0.1)
    assert (state.tension[1:3, middle] <= np.array([0.0, 16.0]) + 1e-9).all()
    assert state.joint_pos[1, JOINT_INDEX["middle_mcp"]] < 0.35
    assert state.joint_pos[0, JOINT_INDEX["middle_mcp"]] > 0.5
