"""What randomize= draws, from which streams, and what it does to the simulated hand."""

from dataclasses import fields, replace
from itertools import islice

import numpy as np
import pytest

from hpac_gym.envs import GoalEnv, Grasp, GraspAny, HandEnv, Posture, ScriptedClosure
from hpac_gym.envs.commands import LinkFaults
from hpac_gym.envs.randomization import PRESETS, Randomization, changed_setup
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC
from hpac_gym.physics.supports import support_boxes
from hpac_gym.tasks.placing import BOARD
from tests.envs.episodes import steps

BOUNDS = {quantity.name: quantity.metadata["bounds"] for quantity in fields(Randomization)}


def setup_of(seed: int = 0):
    return Grasp().setup(np.random.default_rng(seed))


def test_nominal_is_the_default_and_draws_nothing():
    assert not PRESETS["nominal"].draw(np.random.default_rng(0))
    setup = setup_of()
    assert changed_setup(setup, {}) is setup


def test_a_quantity_more_changes_no_other_draw():
    few = Randomization(slack=(0.0, 1e-3), servo_lag=(0.0, 0.1))
    more = replace(few, object_mass=(0.8, 1.2), dropped_frames=(0.0, 0.1))
    drawn, drawn_more = (each.draw(np.random.default_rng(0)) for each in (few, more))
    np.testing.assert_equal({name: drawn_more[name] for name in ("slack", "servo_lag")}, drawn)


@pytest.mark.parametrize("name", BOUNDS)
def test_each_quantity_alone_changes_the_trajectory_and_only_within_its_range(name, opened):
    low, high = BOUNDS[name]
    chosen = Randomization(**{name: (low + 0.6 * (high - low), low + 0.7 * (high - low))})
    env = opened(HandEnv(Grasp(), randomize=chosen))
    plain = opened(HandEnv(Grasp()))
    _, info = env.reset(seed=1)
    values = np.array(info["randomized"][name])
    assert np.all((values >= getattr(chosen, name)[0]) & (values <= getattr(chosen, name)[1]))
    episode, usual = (
        [
            np.append(each.state.joint_pos, seen)
            for seen, *_ in islice(steps(each, ScriptedClosure(), seed=1), 1, 23)
        ]
        for each in (env, plain)
    )
    differs = not np.array_equal(episode, usual)
    assert differs or name in ("object_mass", "object_friction")
    assert env.hand == plain.hand == HPAC, "the policy's model of the hand is the nominal one"


def test_the_simulated_hand_has_what_was_drawn():
    chosen = Randomization(
        tendon_stiffness=(0.8, 0.8),
        slack=(1e-3, 1e-3),
        joint_friction=(0.01, 0.01),
        skin_friction=(0.5, 0.5),
        object_friction=(1.5, 1.5),
        object_mass=(2.0, 2.0),
        servo_lag=(0.1, 0.1),
        dead_band=(0.03, 0.03),
    )
    setup = setup_of()
    changed = changed_setup(setup, chosen.draw(np.random.default_rng(0)))
    for before, after in zip(setup.hand.digits.values(), changed.hand.digits.values(), strict=True):
        assert after.tendon_stiffness == pytest.approx(0.8 * before.tendon_stiffness)
        assert after.drive_stiffness == pytest.approx(0.8 * before.drive_stiffness)
    settings = changed.hand_settings
    assert (settings.slack, settings.joint_friction) == ((1e-3,) * 5, 0.01)
    assert (settings.servo.lag, settings.servo.dead_band) == (0.1, 0.03)
    assert settings.contact_friction == pytest.approx(0.5 * setup.hand_settings.contact_friction)
    usual = setup.object
    expected = replace(usual, mass=2 * usual.mass, friction=1.5 * usual.friction)
    assert changed.object == expected


@pytest.mark.parametrize("fault", ["dropped_frames", "late_frames"])
def test_a_dropped_frame_leaves_the_servos_where_they_were_a_late_one_on_the_way(
    fault, monkeypatch
):
    with GoalEnv(Posture(), randomize=Randomization(**{fault: (0.5, 0.5)})) as env:
        env.reset(seed=0)
        arrived = []
        commanded = []
        send = env.episodes.simulation.command
        monkeypatch.setattr(
            env.episodes.simulation,
            "command",
            lambda servo, time: (arrived.append(servo[0]), send(servo, time)),
        )
        for step in range(40):
            env.step(np.full(6, np.sin(step / 3), np.float32))
            commanded.append(env.command.servo)
    missed = [step for step in range(1, 40) if not np.array_equal(arrived[step], commanded[step])]
    assert 5 < len(missed) < 35
    for step in missed:
        way = (arrived[step] - arrived[step - 1]) @ (commanded[step] - arrived[step - 1])
        way /= np.sum(np.square(commanded[step] - arrived[step - 1]))
        assert 0 < way < 1 if fault == "late_frames" else way == 0


def test_a_faultless_link_has_no_generator_that_every_state_would_copy():
    with GoalEnv(Posture()) as env:
        env.reset(seed=0)
        assert env.episodes.commands.faults == [LinkFaults()]


@pytest.mark.parametrize("name", BOUNDS)
def test_a_range_is_an_ordered_pair_of_numbers_within_its_bounds(name):
    low, high = BOUNDS[name]
    beyond = [(low, high + 1), (low - 1, high), (high, low), (np.nan, high)]
    for wrong in (
        *beyond,
        high,
        (),
        (high,),
        (low, high, high),
        "ab",
        ("0", "1"),
        *([None] if name != "dead_band" else []),
    ):
        with pytest.raises(ParameterError, match=name):
            Randomization(**{name: wrong})


@pytest.mark.parametrize("offset", [-0.02, 0.02])
def test_a_lying_object_lies_on_its_board_wherever_it_is_moved(offset):
    task = GraspAny()
    drawn = (task.setup(np.random.default_rng(seed)) for seed in range(20))
    lying = [setup for setup in drawn if setup.support and setup.support.table_height]
    assert len({setup.hand_quaternion for setup in lying}) == 2, "beside the hand and below it"
    for setup in lying:
        moved = changed_setup(setup, {"object_position": np.full(2, offset)})
        assert np.abs(moved.position - setup.position).max() == pytest.approx(0.02)
        board, _ = support_boxes(moved)
        assert 2 * board.half_extents[2] == pytest.approx(BOARD)


@pytest.mark.parametrize("corner", [0, 1])
def test_the_physics_stays_stable_at_the_ends_of_every_range(corner, opened):
    """Stiff, slack-free hands and soft, slack ones: closed hard, no joint leaves its limits or
    trembles on.
    """
    ends = {
        name: (bounds[corner], bounds[corner])
        for name, bounds in BOUNDS.items()
        if name != "object_position"
    }
    env = opened(
        HandEnv(Grasp(), randomize=Randomization(**(ends | {"dropped_frames": (0.0, 0.0)})))
    )
    env.reset(
        seed=0,
        options={"setup": replace(setup_of(), position=np.array([0.2, 0.0, 0.3]))},
    )
    for _ in range(22):
        env.step(np.array([0.2, 1, 1, 1, 1, 0.5], np.float32))
    env.episodes.simulation.rest(1.0)
    state = env.episodes.simulation.state()
    assert np.all(state.joint_pos < HPAC.joint_max + 0.1)
    assert np.all(state.joint_pos > HPAC.joint_min - 0.1)
    assert np.all(np.abs(state.joint_vel) < 0.5)
