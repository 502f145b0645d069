"""What tasks rely on in an engine: the same setup and tables give the same bits, whatever was
before and beside.
"""

import dataclasses
import hashlib
import importlib.util
import os
import pkgutil
from contextlib import closing

import numpy as np
import pytest

from hpac_gym.body.hands import hand_set
from hpac_gym.body.objects import ObjectSpec
from hpac_gym.body.urdf import WRIST_EFFORT
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, JOINTS, servo_from_synergy
from hpac_gym.physics.engine import HAND_POSITION, PARTS, PhysicsError, SceneSetup, SceneState
from hpac_gym.physics.settings import HandSettings, ServoSettings, WorldSettings
from hpac_gym.physics.simulation import ENGINES, Simulation, make_engine
from hpac_gym.tasks.grasp import Grasp
from hpac_gym.tasks.pick_place import PickPlace
from hpac_gym.tasks.posture import Posture
from tests.physics.scenes import bits, close, varied

CLOSED = np.array([0.7, *HPAC.synergy_max[1:5], 1.2])
NAMES = (None, "hook", "tweezers")
"""In which fingers and thumb touch each other, and several things touch at once; None is a
primitive.
"""
STEPS = 6
"""Physics steps of a control step."""

engines = pytest.mark.parametrize("name", ENGINES)


def setup(grasp: str | None, seed: int) -> SceneSetup:
    return Grasp(grasp=grasp).setup(np.random.default_rng(seed))


def with_a_hand(start: SceneSetup, seed: int) -> SceneSetup:
    """The setup with one of the hands of the family."""
    variant = hand_set("train")[seed % 4]
    settings = variant.over(start.hand_settings)
    return dataclasses.replace(
        start, hand=variant.hand, geometry=variant.geometry, hand_settings=settings
    )


class Closing:
    """Random commands near a closing hand, and a wrist that lifts and shakes, of one world."""

    def __init__(self, start: SceneSetup, seed: int) -> None:
        self.start = start
        self.seed = seed
        self.step = 0
        self.rng = np.random.default_rng(seed)
        self.digest = hashlib.sha256()

    def servo(self) -> np.ndarray:
        synergy = np.clip(
            CLOSED * min(1.0, self.step / 14) * self.rng.uniform(0.7, 1.0, 6), 0.0, HPAC.synergy_max
        )
        return servo_from_synergy(synergy)

    def wrist(self) -> np.ndarray:
        times = np.arange(STEPS * self.step, STEPS * (self.step + 1)) / 120
        self.step += 1
        return Grasp().wrist_path(self.start, tuple(times.tolist()))

    def take(self, state: SceneState, world: int) -> None:
        for field in dataclasses.fields(state):
            self.digest.update(getattr(state, field.name)[world].tobytes())


def advance(simulation: Simulation, episodes: list[Closing]) -> None:
    """One control step of every world."""
    simulation.command(np.array([episode.servo() for episode in episodes]), 0.05)
    simulation.advance(np.array([episode.wrist() for episode in episodes]))
    state = simulation.state()
    for world, episode in enumerate(episodes):
        episode.take(state, world)


def begin(simulation: Simulation, episodes: dict[int, Closing]) -> None:
    """The start of episodes in some worlds."""
    simulation.reset(list(episodes), [episode.start for episode in episodes.values()])
    state = simulation.state()
    for world, episode in episodes.items():
        episode.take(state, world)


def digest_alone(engine: str, start: SceneSetup, seed: int, steps: int) -> str:
    """A hash over all states of one episode in a new engine of one world."""
    with closing(make_engine(engine)) as physics:
        simulation = Simulation(physics)
        episode = Closing(start, seed)
        begin(simulation, {0: episode})
        for _ in range(steps):
            advance(simulation, [episode])
    return episode.digest.hexdigest()


@engines
def test_an_episode_is_the_same_to_the_bit_after_others_and_beside_others(name, begun, monkeypatch):
    """Worlds whose episodes begin and end at different times, of every layout and with several hands,
    with visual shapes and two threads, against new engines of one world.
    """
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: range(2))
    simulation = begun(name, *[SceneSetup(None)] * 4, visuals=True)
    rng = np.random.default_rng(0)
    pool = [with_a_hand(setup(grasp, seed), seed) for seed, grasp in enumerate(NAMES)]
    pool += varied(name)
    order = [*rng.permutation(len(pool)), *rng.permutation(len(pool))[:4]]
    due = [Closing(pool[index], index) for index in order]
    episodes: dict[int, Closing] = {}
    lengths = {}
    over = [2, 0, 3, 1]
    told = []
    while len(told) < len(pool):
        started = {world: due.pop() for world in over}
        lengths |= {world: int(rng.integers(12, 22)) for world in over}
        begin(simulation, started)
        episodes |= started
        over = []
        while not over:
            advance(simulation, [episodes[world] for world in range(4)])
            over = [world for world in range(4) if episodes[world].step == lengths[world]]
        told += [episodes[world] for world in over]
    for episode in told:
        alone = digest_alone(name, episode.start, episode.seed, episode.step)
        assert episode.digest.hexdigest() == alone, f"setup {episode.seed}"


@pytest.mark.parametrize(
    ("name", "call", "seed"),
    [
        ("mujoco", "hpac_gym.physics.mujoco.parameters.Parameters._set_hand", 1),
        ("pybullet", "pybullet.resetSimulation", 2),
        ("pybullet", "pybullet.loadURDF", 2),
        ("pybullet", "pybullet.changeDynamics", 1),
        ("pybullet", "pybullet.createMultiBody", 1),
    ],
)
def test_a_reset_that_was_interrupted_leaves_nothing_behind(name, call, seed, begun, monkeypatch):
    """By Ctrl-C, which Python notices when a call of C code returns; the setup that was interrupted
    comes again, or that before it, with a stiffer hand or with another one.
    """
    start = with_a_hand(setup("hook", 0), 1)
    other = with_a_hand(start, seed)
    stiff = 2 * other.hand.cmc_stiffness
    other = dataclasses.replace(other, hand=dataclasses.replace(other.hand, cmc_stiffness=stiff))
    simulation = begun(name, start, start)
    function = pkgutil.resolve_name(call)

    def interrupted(*given, **more):
        function(*given, **more)
        raise KeyboardInterrupt

    wanted = {id(one): digest_alone(name, one, 0, 4) for one in (other, start)}
    for following in (other, start):
        simulation.reset([0, 1], [start] * 2)
        with monkeypatch.context() as patch:
            patch.setattr(call, interrupted)
            with pytest.raises(KeyboardInterrupt):
                simulation.reset([0], [other])
        simulation.reset([0], [following])
        episodes = [Closing(following, 0), Closing(start, 0)]
        first = simulation.state()
        for world, episode in enumerate(episodes):
            episode.take(first, world)
        for _ in range(4):
            advance(simulation, episodes)
        for episode in episodes:
            assert episode.digest.hexdigest() == wanted[id(episode.start)]


@engines
def test_the_tables_move_servos_and_wrist_and_the_hand_alone_stays_where_it_is(name, begun):
    engine = begun(name, setup(None, 0), Posture().setup(np.random.default_rng(0))).engine
    wrist = np.linspace(0.0, 0.03, 30)[:, None] * [0.0, 0.5, 1.0]
    servo = np.tile(servo_from_synergy([0, 0.3, 0, 0, 0, 1.2]), (2, 30, 1))
    engine.advance(servo, np.zeros_like(servo), np.array([wrist, wrist]))
    state = engine.state()
    np.testing.assert_allclose(state.time, 30 * engine.dt)
    np.testing.assert_allclose(
        state.palm_offset, [wrist[-1], np.zeros(3)], atol=2e-6 if name == "mujoco" else 1e-4
    )
    left_behind = setup(None, 0).position - setup(None, 0).hand_rotation.T @ wrist[-1]
    np.testing.assert_allclose(state.object_pos[0], left_behind, atol=1e-3)
    assert (state.joint_pos[:, JOINTS.index("index_mcp")] > 0.1).all()
    assert not state.touching[1].any()
    assert state.supported.tolist() == [True, False]
    engine.close()  # and once more after the test


@engines
@pytest.mark.parametrize("effort", [None, 100.0])
def test_the_wrist_pushes_against_an_obstacle_with_its_force(name, effort, begun):
    """The palm moves 20 mm into a fixed box. The limit is 200 N in PyBullet and, unless it is set,
    none in MuJoCo.
    """
    box = ObjectSpec("box", (0.02, 0.015, 0.015), 1.0, 0.8)
    start = SceneSetup(box, np.array([0.0425, -0.02, 0.05]), fixed=True)
    simulation = begun(name, start, settings=WorldSettings(wrist_effort=effort))
    way = np.append(np.linspace(0.0, 0.03, 60), np.full(60, 0.03))
    simulation.advance((way[:, None] * start.hand_rotation[:, 0])[None])
    (force,) = simulation.state().contact_force[:, PARTS.index("palm")]
    if effort is None and name == "mujoco":
        assert force > 1e4
    else:
        assert force == pytest.approx(effort or WRIST_EFFORT, rel=0.01)


@engines
def test_a_state_is_not_changed_by_what_comes_after_it(name, begun):
    simulation = begun(name, setup(None, 1))
    first = simulation.state()
    kept = {field.name: getattr(first, field.name).copy() for field in dataclasses.fields(first)}
    simulation.command(servo_from_synergy(CLOSED)[None], 0.4)
    simulation.rest(0.5)
    simulation.state()
    for field, value in kept.items():
        np.testing.assert_array_equal(getattr(first, field), value)


@engines
def test_a_new_episode_has_no_forces_of_the_one_before(name, begun):
    start = setup(None, 1)
    simulation = begun(name, start, start)
    simulation.engine.every_step = True
    simulation.command(np.tile(servo_from_synergy(CLOSED), (2, 1)), 0.4)
    simulation.rest(0.8)
    before = simulation.state().force_steps
    simulation.reset([1], [start])
    np.testing.assert_array_equal(simulation.state().force_steps, before * [[1.0], [0.0]])
    assert before.max(axis=1).min() > 1.0


@engines
@pytest.mark.parametrize(
    ("grasp", "begin"),
    [(None, 0.5), ("screwdriver", 0.2)],
    ids=["of a primitive", "of one with its mass beside its centre"],
)
def test_velocity_and_spin_are_the_rates_of_place_and_rotation(name, grasp, begin, begun):
    """Of an object that a closing hand pushes, along the axes of the hand frame, over one physics
    step.
    """
    simulation = begun(name, setup(grasp, 3))
    simulation.command(servo_from_synergy(CLOSED)[None], 0.4)
    simulation.rest(begin)
    moved = turned = 0.0
    for _ in range(60):
        before = simulation.state()
        simulation.rest(simulation.engine.dt)
        after = simulation.state()
        rate = (after.object_pos - before.object_pos)[0] / simulation.engine.dt
        np.testing.assert_allclose(after.object_vel[0], rate, atol=5e-3)
        turn = after.object_rotation[0] @ before.object_rotation[0].T
        spin = (
            np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            / 2
            / simulation.engine.dt
        )
        np.testing.assert_allclose(after.object_spin[0], spin, atol=2e-2)
        moved = max(moved, np.abs(rate).max())
        turned = max(turned, np.abs(spin).max())
    assert moved > 0.02
    assert turned > 0.1


@engines
def test_the_brake_of_a_slack_drive_is_no_tension(name, begun):
    """Fingers that overrun their servos, which stop halfway."""
    simulation = begun(name, SceneSetup(None))
    simulation.command(servo_from_synergy(HPAC.synergy_max / 2)[None], 0.1)
    lowest = []
    for _ in range(40):
        simulation.rest(simulation.engine.dt)
        lowest.append(simulation.state().tension.min())
    assert min(lowest) == 0.0


@engines
def test_a_joint_stops_at_the_workspace_of_its_hand(name, begun):
    """Of hands that follow each other in one world: a narrower one, the nominal one, the narrower."""
    joint = JOINTS.index("index_mcp")
    narrow = dataclasses.replace(HPAC, workspace={**HPAC.workspace, "index_mcp": (0.0, 0.8)})
    simulation = begun(name, SceneSetup(None, hand=narrow))
    for hand in (narrow, HPAC, narrow):
        simulation.reset([0], [SceneSetup(None, hand=hand)])
        simulation.command(HPAC.servo_max[None], 0.4)
        simulation.rest(1.0)
        stop = hand.joint_max[joint]
        assert simulation.state().joint_pos[0, joint] == pytest.approx(stop, abs=0.02)


@engines
@pytest.mark.parametrize("model", [None, "hexagonal_screwdriver", "scissors"])
def test_a_push_at_the_centre_of_mass_accelerates_by_force_over_mass_and_turns_nothing(
    name, model, begun
):
    """Without weight, in the air: pushed all the time, in the first half of it, and not at all."""
    # Larger than the named ones, whose post is that far below.
    spec = ObjectSpec("box", (0.12, 0.12, 0.12), 0.2, 0.8, model)
    start = SceneSetup(spec, np.array([0.4, 0.4, 0.4]), 0.3)
    engine = begun(name, start, start, start, settings=WorldSettings(gravity=0.0)).engine
    steps = 24
    servo = np.zeros((3, steps, 6))
    push = np.zeros((3, steps, 3))
    push[0] = [3.0, -2.0, 4.0]
    push[1, : steps // 2] = [3.0, -2.0, 4.0]
    engine.advance(servo, servo, np.zeros((3, steps, 3)), push)
    wanted = push.sum(axis=1) * engine.dt / spec.mass
    for _ in range(2):
        state = engine.state()
        np.testing.assert_allclose(
            state.object_vel @ start.hand_rotation.T, wanted, rtol=1e-6, atol=1e-6
        )
        np.testing.assert_allclose(state.object_spin, 0.0, atol=1e-6)
        engine.advance(servo, servo, np.zeros((3, steps, 3)))  # a push ends with its table


@engines
def test_no_push_and_a_push_of_nothing_are_the_same_bits(name, begun):
    """A closing hand; the push comes and goes before a reset, in a world beside another layout, a
    fixed object and none.
    """
    obstacle = dataclasses.replace(setup(None, 2), fixed=True)
    starts = [
        setup(None, 3),
        obstacle,
        setup("scissors", 1),
        Posture().setup(np.random.default_rng(0)),
    ]
    simulation = begun(name, *starts)
    found = []
    wrist = np.zeros((len(starts), 24, 3))
    for push in (None, np.zeros_like(wrist), np.ones_like(wrist), None):
        simulation.reset(range(len(starts)), starts)
        simulation.command(np.tile(servo_from_synergy(CLOSED), (len(starts), 1)), 0.4)
        simulation.advance(wrist, push)
        simulation.advance(wrist)
        found.append(simulation.state())
    for field in dataclasses.fields(SceneState):
        first, zero, pushed, last = (getattr(state, field.name) for state in found)
        np.testing.assert_array_equal(first, zero, err_msg=field.name)
        np.testing.assert_array_equal(first, last, err_msg=field.name)
        # What cannot move.
        np.testing.assert_array_equal(first[[1, 3]], pushed[[1, 3]], err_msg=field.name)
    assert (np.abs(found[0].object_pos - found[2].object_pos).max(axis=1) > 1e-3).tolist() == [
        True,
        False,
        True,
        False,
    ]


@engines
def test_snapshots_of_every_layout_go_on_to_the_bit_though_the_array_of_pushes_is_used_again(
    name, begun
):
    setups = varied(name)
    engine = begun(name, *setups).engine
    push = np.full((len(setups), STEPS, 3), 0.5)
    close(engine, 8, push)
    snapshots = [engine.save(world) for world in range(len(setups))]
    push[:] = 0.0
    seen = [engine.state(), *close(engine, 4)]
    for world, snapshot in enumerate(snapshots):
        engine.restore(world, snapshot)
    found = [engine.state(), *close(engine, 4)]
    for world in range(len(setups)):
        assert bits(found, world) == bits(seen, world), f"setup {world}"
    assert np.abs(seen[0].object_vel[0]).max() > 0.1


@engines
def test_contacts_are_those_of_the_state_and_push_into_the_object(name, begun):
    start = setup("large_cylinder", 0)
    simulation = begun(name, start)
    simulation.command(servo_from_synergy(Grasp(grasp="large_cylinder").grasp.closed)[None], 0.8)
    simulation.rest(1.2)
    state = simulation.state()
    contacts = simulation.engine.contacts(0)
    parts = [
        next((part for part in PARTS if link.startswith(part)), None) for link in contacts.link
    ]
    force = [contacts.force[[part == name for part in parts]].sum() for name in PARTS]
    # An engine may compute its contacts anew.
    np.testing.assert_allclose(state.contact_force[0], force, rtol=1e-3)
    assert (state.contact_force[0][~state.touching[0]] == 0.0).all()
    assert state.touching[0].sum() >= 3
    np.testing.assert_allclose(np.linalg.norm(contacts.normal, axis=1), 1.0)
    np.testing.assert_allclose(
        contacts.centre, HAND_POSITION + start.hand_rotation @ state.object_pos[0], atol=1e-6
    )
    inward = contacts.centre - contacts.point
    inward[:, 2] = 0.0  # to the axis of the standing can
    assert (np.einsum("ij,ij->i", inward, contacts.normal) > 0).all()
    assert contacts.friction == pytest.approx(0.9 * start.object.friction)


@pytest.mark.pybullet
def test_a_point_of_contact_in_pybullet_is_on_the_object_and_not_on_the_skin_inside_of_it(begun):
    """The skin is 1e-5 m inside of a can that it squeezes."""
    can = ObjectSpec("cylinder", (0.027, 0.027, 0.05), mass=0.15, friction=0.9)
    opposed = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2])
    start = SceneSetup(can, np.array([0.048, 0.004, 0.112]), synergy=opposed)
    simulation = begun("pybullet", start)
    simulation.command(servo_from_synergy(CLOSED)[None], 0.8)
    simulation.rest(1.2)
    contacts = simulation.engine.contacts(0)
    rotation = start.hand_rotation @ simulation.state().object_rotation[0]
    place = (contacts.point - contacts.centre) @ rotation
    assert len(place) >= 3
    # A contact that lasts stays where it began: few are further off.
    assert np.median(np.abs(np.hypot(place[:, 0], place[:, 1]) - 0.027)) < 3e-6


@pytest.mark.pybullet
def test_a_failed_simulation_in_pybullet_names_its_world(begun):
    engine = begun("pybullet", *(setup(None, seed) for seed in range(3))).engine
    servo = np.zeros((3, STEPS, 6))
    servo[1] = np.nan
    engine.advance(servo, np.zeros_like(servo), np.zeros((3, STEPS, 3)))
    with pytest.raises(PhysicsError, match=r"world 1 of 3: joint angles .* are not finite"):
        engine.state()


@engines
def test_a_simulation_has_the_servos_of_each_world(name, begun):
    """A world whose servos are slow lags behind one whose servos are not."""
    start = PickPlace().setup(np.random.default_rng(0))
    slow = dataclasses.replace(start, hand_settings=HandSettings(servo=ServoSettings(speed=0.5)))
    simulation = begun(name, start, slow)
    np.testing.assert_allclose(
        simulation.state().horn, servo_from_synergy(start.synergy)[None].repeat(2, axis=0)
    )
    simulation.command(np.tile(HPAC.servo_max, (2, 1)), 0.05)
    simulation.rest(0.2)
    horn = simulation.state().horn
    assert (horn[0, :5] > 1.2).all()
    np.testing.assert_allclose(horn[1, :5], 0.1, atol=1e-9)


def test_an_engine_is_asked_for_by_name():
    with pytest.raises(ParameterError, match="engine 'newton' is not one of pybullet, mujoco"):
        make_engine("newton")
    with pytest.raises(ParameterError, match="0 worlds: at least 1 is needed"):
        make_engine("mujoco", 0)


def test_an_engine_that_is_not_installed_says_what_to_do(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for name, advice in {"pybullet": "engine='mujoco'", "mujoco": "mujoco-core"}.items():
        with pytest.raises(ParameterError, match=advice):
            make_engine(name)
