"""HPAC-Grasp-v0: what is seen, what counts. The contract of Gymnasium and determinism are in
test_gate.py.
"""

import gymnasium
import numpy as np
import pytest

from hpac_gym.body.objects import ObjectSpec
from hpac_gym.envs import Grasp, ScriptedClosure
from hpac_gym.model import HPAC
from hpac_gym.tasks.grip import MAX_SLIP
from hpac_gym.tasks.occlusion import SKIN, points_in_object
from hpac_gym.tasks.phases import Timetable, wrist_table
from tests.envs.episodes import Opens, Still, a_setup, run, steps

ID = "HPAC-Grasp-v0"


@pytest.fixture(scope="module")
def env():
    with gymnasium.make(ID) as made:
        yield made


@pytest.fixture(scope="module")
def lifted(env):
    """What every step of the scripted closure on an easy cylinder returns, and the state after
    it.
    """
    return [
        (returned, env.unwrapped.state) for returned in steps(env, ScriptedClosure(), a_setup())
    ][1:]


def test_scripted_closure_lifts_an_easy_cylinder(lifted):
    (*_, last), _ = lifted[-1]
    assert last["is_success"]
    assert last["hold_time"] >= Timetable().shake_time + Timetable().place_time - 1e-9
    assert sum(reward for (_, reward, *_), _ in lifted) > 10.0


def test_an_open_hand_leaves_the_object_on_its_post_and_fails(env):
    infos, _ = run(env, Still(), a_setup())
    assert not infos[-1]["is_success"]
    assert infos[-1]["outcome"] == "failure"
    assert infos[-1]["hold_time"] == 0.0


@pytest.mark.parametrize(
    ("policy", "change", "phases", "steps"),
    [
        (ScriptedClosure(), {"friction": 0.02, "mass": 1.0}, {"lift", "shake"}, 64),
        (Opens(ScriptedClosure(), 1.2), {}, {"lift", "shake"}, 38),
        (Opens(ScriptedClosure(), 1.8), {}, {"shake"}, 50),
        (Opens(ScriptedClosure(), 2.5), {}, {"shake", "place"}, 64),
    ],
    ids=["a slippery, heavy object", "opens in the lift", "opens in the shake", "opens at its end"],
)
def test_an_object_that_is_dropped_on_the_way_fails_before_the_end(
    env, policy, change, phases, steps
):
    infos, _ = run(env, policy, a_setup(**change))
    assert infos[-1]["outcome"] == "failure"
    assert infos[-1]["phase"] in phases
    assert len(infos) < steps


def test_an_object_that_slides_through_the_hand_is_not_held(env):
    """A smooth, heavy can creeps through the closed hand: touched all the time, and lost by
    `MAX_SLIP`.
    """
    infos, _ = run(
        env, ScriptedClosure(), a_setup(friction=0.12, half_extents=(0.027, 0.027, 0.06), mass=0.4)
    )
    assert infos[-1]["outcome"] == "failure"
    assert infos[-1]["contact_force"] > 0
    assert infos[-1]["slip"] > MAX_SLIP


def test_the_wrist_path_shakes_in_six_directions_and_its_velocity_never_jumps():
    table = Timetable()
    dt = 1e-3
    times = np.arange(0, table.ends[-1] + dt, dt)
    offsets = wrist_table(table, tuple(times.tolist()))
    accelerations = np.diff(offsets, 2, axis=0) / dt**2
    # [m/s²]; a jump of 0.4 m/s would be one of 400.
    assert 15.0 < np.abs(accelerations).max() < 25.0
    _, begin, end, _ = table.ends
    shaking = offsets[(times > begin) & (times < end)] - [0, 0, table.lift_height]
    np.testing.assert_allclose(shaking.max(axis=0), table.shake_distance, rtol=0.02)
    np.testing.assert_allclose(shaking.min(axis=0), -table.shake_distance, rtol=0.02)
    np.testing.assert_allclose(offsets[-1], [0, 0, table.clearance], atol=1e-9)


def test_the_palm_is_where_its_path_says(lifted):
    """Also in the lift and in the shake, with an object in the hand."""
    states = [state for _, state in lifted]
    path = wrist_table(Timetable(), tuple(state.time[0] for state in states))
    offsets = np.concatenate([state.palm_offset for state in states])
    np.testing.assert_allclose(offsets, path, atol=1e-4)
    assert np.ptp(offsets, axis=0).min() > 0.03


def test_the_effort_counts_the_change_though_the_caller_writes_over_his_action(env):
    env.reset(seed=4)
    action = np.zeros(6)
    env.step(action)
    action[:] = 0.5
    *_, info = env.step(action)
    assert info["reward_terms"]["effort"] == pytest.approx(-0.01 * 6 * 0.25)


def test_a_drawn_setup_is_taken_back_though_a_box_touches_the_thumb(env):
    env.reset(seed=22094)
    (drawn,) = env.unwrapped.episodes.setups
    assert points_in_object(drawn) > 0
    env.reset(seed=0, options={"setup": drawn})


def test_a_wide_object_of_ones_own_is_placed_where_the_hand_is_not():
    task = Grasp(object=ObjectSpec("sphere", (0.06, 0.06, 0.06), mass=0.1, friction=0.8))
    rng = np.random.default_rng(0)
    drawn = [task._drawn(rng, HPAC) for _ in range(40)]
    assert sum(points_in_object(setup) > 0 for setup in drawn) > 10
    assert not any(points_in_object(task.setup(rng), SKIN) for _ in range(40))


def test_commands_respect_the_rate_limit(env):
    env.reset(seed=0)
    last = env.unwrapped.command.servo
    rng = np.random.default_rng(0)
    for _ in range(15):
        *_, terminated, _, _ = env.step(rng.choice([-1.0, 1.0], 6).astype(np.float32))
        command = env.unwrapped.command
        assert np.all(
            np.abs(command.servo - last) <= HPAC.servo_rate_limit * command.duration + 1e-12
        )
        last = command.servo
        if terminated:
            break
