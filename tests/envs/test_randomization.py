"""What randomize= draws, from which streams, and what it does to the simulated hand."""

import dataclasses

import gymnasium
import numpy as np
import pytest

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.envs import Grasp, HandEnv, ScriptedClosure
from hpac_gym.envs.randomization import BOUNDS, PRESETS, Randomization, changed_setup, stream
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC, ServoCommand
from hpac_gym.sim import Servos, ServoSettings


def setup_of(seed: int = 0):
    return Grasp().setup(np.random.default_rng(seed))


def test_nominal_is_the_default_and_draws_nothing():
    assert not PRESETS["nominal"].draw(np.random.default_rng(0))
    setup = setup_of()
    assert changed_setup(setup, {}) is setup


def test_a_quantity_more_changes_no_other_draw():
    rng = np.random.default_rng(0)
    few = Randomization(slack=(0.0, 1e-3), servo_lag=(0.0, 0.1))
    more = dataclasses.replace(few, object_mass=(0.8, 1.2), joint_friction=(0.0, 0.01), dropped_frames=(0.0, 0.1))
    drawn, drawn_more = few.draw(rng), more.draw(rng)
    assert set(drawn) == {"slack", "servo_lag"}
    for name, values in drawn.items():
        np.testing.assert_array_equal(values, drawn_more[name])


def test_a_stream_does_not_depend_on_what_its_parent_has_drawn():
    rng = np.random.default_rng(4)
    first = stream(rng, "slack").random(3)
    rng.random(10)
    rng.spawn(2)
    np.testing.assert_array_equal(stream(rng, "slack").random(3), first)
    assert not np.array_equal(stream(rng, "servo_lag").random(3), first)


def test_the_task_draws_the_same_episode_with_and_without_randomization():
    plain, full = HandEnv(Grasp()), HandEnv(Grasp(), randomize="full")
    plain.reset(seed=3)
    full.reset(seed=3)
    assert plain.scene.object.spec.half_extents == full.scene.object.spec.half_extents
    assert plain.scene.object.spec.mass != full.scene.object.spec.mass
    plain.close()
    full.close()


@pytest.mark.parametrize("name", BOUNDS)
def test_each_quantity_alone_changes_the_trajectory_and_only_within_its_range(name):
    low, high = BOUNDS[name]
    chosen = Randomization(**{name: (low + 0.6 * (high - low), low + 0.7 * (high - low))})
    env, plain = HandEnv(Grasp(), randomize=chosen), HandEnv(Grasp())
    observation, info = env.reset(seed=1)
    values = np.array(info["randomized"][name])
    assert np.all((values >= getattr(chosen, name)[0]) & (values <= getattr(chosen, name)[1]))
    reference, _ = plain.reset(seed=1)
    policy, differs = ScriptedClosure(), False
    policy.reset()
    for _ in range(22):
        action = policy.act(observation)
        observation, _, over, *_ = env.step(action)
        reference, _, plain_over, *_ = plain.step(action)
        differs |= not np.array_equal(env.scene.hand.joint_pos, plain.scene.hand.joint_pos)
        differs |= not np.array_equal(observation, reference)
        if over or plain_over:
            break
    assert differs or name in ("object_mass", "object_friction")
    assert env.hand == plain.hand == HPAC, "the policy's model of the hand is the nominal one"
    env.close()
    plain.close()


def test_the_simulated_hand_has_what_was_drawn():
    chosen = Randomization(
        tendon_stiffness=(0.8, 0.8), slack=(1e-3, 1e-3), joint_friction=(0.01, 0.01), skin_friction=(0.5, 0.5),
        object_friction=(1.5, 1.5), object_mass=(2.0, 2.0), servo_lag=(0.1, 0.1), dead_band=(0.03, 0.03),
    )  # fmt: skip
    setup = setup_of()
    changed = changed_setup(setup, chosen.draw(np.random.default_rng(0)))
    for before, after in zip(setup.hand.digits.values(), changed.hand.digits.values(), strict=True):
        assert after.tendon_stiffness == pytest.approx(0.8 * before.tendon_stiffness)
        assert after.drive_stiffness == pytest.approx(0.8 * before.drive_stiffness)
    settings = changed.hand_settings
    assert settings.slack == (1e-3,) * 5
    assert settings.joint_friction == 0.01
    assert settings.contact_friction == pytest.approx(0.45)
    assert (settings.servo.lag, settings.servo.dead_band) == (0.1, 0.03)
    assert changed.object.mass == pytest.approx(2 * setup.object.mass)
    assert changed.object.friction == pytest.approx(1.5 * setup.object.friction)


@pytest.mark.parametrize("lag", [0.0, 0.05, 0.15])
def test_a_lagging_servo_answers_one_lag_later(lag):
    dt, servos, prompt = 1 / 240, Servos(ServoSettings(lag=lag)), Servos()
    late = round(lag / dt)
    answers, expected = [], [np.zeros(6)] * late
    for step in range(80):
        if step % 12 == 0:
            command = ServoCommand(np.full(6, 0.1 + 0.1 * (step % 24 == 0)), 0.05)
            servos.command(command)
            prompt.command(command)
        servos.advance(dt)
        prompt.advance(dt)
        answers.append(servos.horn.copy())
        expected.append(prompt.horn.copy())
    np.testing.assert_array_equal(answers, expected[:80])


def test_every_frame_that_is_dropped_leaves_the_servos_where_they_were():
    env = HandEnv(Grasp(), randomize=Randomization(dropped_frames=(0.5, 0.5)))
    env.reset(seed=0)
    arrived, advance = [], env.scene.advance
    env.scene.advance = lambda command, path: (arrived.append(command.servo), advance(command, path))
    commanded = []
    for step in range(40):
        *_, over, _, _ = env.step(np.full(6, np.sin(step / 3), np.float32))
        commanded.append(env.command.servo)
        if over:
            env.reset()
    lost = [not np.array_equal(a, c) for a, c in zip(arrived, commanded, strict=True)]
    assert 5 < sum(lost) < 35
    env.close()


@pytest.mark.parametrize("wrong", ["wild", Randomization.__name__])
def test_an_unknown_preset_is_named(wrong):
    with pytest.raises(ParameterError, match=wrong):
        gymnasium.make("HPAC-Grasp-v0", randomize=wrong)


@pytest.mark.parametrize("name", BOUNDS)
def test_a_range_out_of_bounds_or_out_of_order_raises(name):
    low, high = BOUNDS[name]
    for wrong in ((low, high + 1), (low - 1, high), (high, low), (np.nan, high)):
        with pytest.raises(ParameterError, match=name):
            Randomization(**{name: wrong})


@pytest.mark.parametrize("corner", [0, 1])
def test_the_physics_stays_stable_at_the_ends_of_every_range(corner):
    """Stiff, slack-free hands and soft, slack ones: closed hard, no joint leaves its limits or trembles on."""
    ends = {name: (bounds[corner], bounds[corner]) for name, bounds in BOUNDS.items() if name != "object_position"}
    env = HandEnv(Grasp(), randomize=Randomization(**(ends | {"dropped_frames": (0.0, 0.0)})))
    env.reset(seed=0, options={"setup": dataclasses.replace(setup_of(), position=np.array([0.2, 0.0, 0.3]))})
    for _ in range(22):
        env.step(np.array([0.2, 1, 1, 1, 1, 0.5], np.float32))
    for _ in range(20):
        env.scene.advance(env.command, env.task.timetable.wrist_path)
    position, speed = env.scene.hand.joint_state()
    assert np.all(position < HPAC.joint_max + 0.1)
    assert np.all(position > HPAC.joint_min - 0.1)
    assert np.all(np.abs(speed) < 0.5)
    env.close()
