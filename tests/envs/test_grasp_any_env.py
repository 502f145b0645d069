"""HPAC-GraspAny-v1: what is seen, what the first action moves, what counts. The contract is in
test_gate.py.
"""

from dataclasses import replace
from functools import partial
from itertools import islice

import gymnasium
import numpy as np
import pytest

from hpac_gym.body.hands import hand_set
from hpac_gym.body.objects import Support
from hpac_gym.envs import GraspAnySetup, HandVectorEnv
from hpac_gym.evaluation.seeds import BENCHMARK_SEED
from hpac_gym.model import JOINT_INDEX, SERVOS, action_from_synergy
from hpac_gym.physics.engine import SceneSetup, SceneState
from hpac_gym.physics.settings import BODIES
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.tasks import placing
from hpac_gym.tasks.grasp_any import PHASES, RAMP, SIDE_DIRECTIONS, SIDES, GraspAny, GraspAnyConfig
from hpac_gym.tasks.senses import ServoSenses
from hpac_gym.tasks.terms import GRASP_CENTRE, LENGTH_UNIT
from tests.envs.episodes import Opens, Still, a_setup, run, steps

ID = "HPAC-GraspAny-v1"
make = partial(gymnasium.make, ID)
CLOSED = np.array([0.28, 1, 1, 1, 1, 0.53], np.float32)
"""Thumb opposite to the fingers, all of them closed."""
ROOTS = [JOINT_INDEX[name] for name in SERVOS[:5]]


def easy(**change) -> SceneSetup:
    """A can that the closed hand keeps, pulled down in the end."""
    return a_setup().to(GraspAnySetup, **{"pull": np.array([0.0, 0.0, -1.0])} | change)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_easy_object_is_held_and_judged_to_the_end(engine):
    with make(engine=engine) as env:
        infos, _ = run(env, Still(CLOSED), easy())
    names = [info["phase"] for info in infos]
    assert sorted(names, key=PHASES.index) == names
    assert infos[-1]["is_success"]
    assert infos[-1]["sides"] == len(SIDE_DIRECTIONS)
    assert infos[-1]["holding_force"] > 1.0
    assert infos[-1]["turn"] < 0.3
    assert all(info["holding_force"] == 0 for info in infos if info["phase"] != "ramp")


def test_a_hand_that_opens_loses_what_it_would_have_won():
    lift, shake, sides, ramp = GraspAnyConfig().ends[:4]
    with make() as env:
        for opens, phases, won in (
            (lift, {"lift", "shake"}, False),
            (shake, {"shake"}, False),
            (sides, {"sides", "ramp"}, True),
            (ramp + 0.3, {"ramp"}, True),
        ):
            infos, _ = run(env, Opens(Still(CLOSED), opens + 0.01), easy())
            last = infos[-1]
            assert (last["is_success"], last["phase"] in phases) == (won, True)
            assert 0.0 <= last["holding_force"] < 40.0
            assert (last["holding_force"] > 0.0) == (opens > ramp)


def test_the_force_grows_from_zero_along_its_direction_after_gravity_came_from_six_sides():
    task = GraspAny("real")
    config = GraspAnyConfig()
    setup = easy()
    task.prepare(1, None)
    task.start([0], [setup])
    assert task.push(np.array([[0.1, config.ends[SIDES - 1]]])) is None
    weight = setup.object.mass * 9.81
    for side, direction in enumerate(SIDE_DIRECTIONS):
        time = config.ends[SIDES - 1] + (side + 0.5) * config.side_time
        felt = task.push(np.array([[time]]))[0, 0] + [0.0, 0.0, -weight]
        np.testing.assert_allclose(felt, weight * direction, atol=1e-12)
    times = np.linspace(config.ends[SIDES], config.ends[RAMP], 9)[1:]
    expected = np.outer(np.linspace(0, config.ramp_force, 9)[1:], setup.pull)
    np.testing.assert_allclose(task.push(times[None])[0], expected, atol=1e-9)


def test_what_is_knocked_over_may_be_grasped_again_and_what_is_out_of_reach_is_lost():
    task = GraspAny("real")
    task.prepare(2, None)
    task.start([0, 1], [easy(), easy()])
    state = SceneState.empty(2)
    state.object_pos[:] = GRASP_CENTRE
    state.object_pos[:, 1] -= [0.13, 0.17]
    assert task.judge(state, 0.05).tolist() == [0, 2]


# What is seen
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("obs", ["deploy", "load", "points", "privileged"])
def test_a_critic_alone_sees_mass_and_friction(obs):
    with make(obs=obs) as env:
        setup = easy()
        spec = setup.object
        heavy = replace(spec, mass=1.5 * spec.mass, friction=0.3 * spec.friction)
        first, second = (
            env.reset(seed=3, options={"setup": given})[0]
            for given in (setup, replace(setup, object=heavy))
        )
        for name in ("object_mass", "object_friction") if obs == "privileged" else ():
            part = env.unwrapped.slices[name]
            assert first[part] != second[part]
            first[part] = second[part]
    np.testing.assert_equal(first, second)


def test_a_horn_that_stays_behind_tells_an_object_from_none(opened):
    """Held digits of 30 closures; the commands and the horns of ideal servos cannot tell."""
    env = opened(gymnasium.make_vec(ID, num_envs=30, engine="mujoco", obs="load"))
    episodes = env.unwrapped.episodes
    actions = np.random.default_rng(0).uniform(-0.3, 0.9, (30, 6))
    found = []
    for there in (True, False):
        env.reset(seed=5000)
        if not there:
            away = [
                replace(s, position=s.position + np.array([0, 0, 5.0])) for s in episodes.setups
            ]
            episodes._begin(range(30), away)
        for _ in range(24):
            episodes.step(actions)
        behind = 0.1 * episodes.observe()[:, env.unwrapped.slices["horn_lag"]][:, :5]
        state = episodes.simulation.state()
        found.append((behind, state.joint_pos[:, ROOTS], state.horn, episodes.outcome))
    (lag, root, horn, outcome), (free_lag, free_root, free_horn, _) = found
    # Digits that do not press on each other without an object, in episodes that still run.
    clear = (np.abs(free_lag) < 0.02) & (outcome == 0)[:, None]
    held = clear & (free_root - root > 0.03)
    told = lag - free_lag > 0.01
    assert held.sum() > 30
    assert told[held].mean() > 0.99
    np.testing.assert_array_equal(horn, free_horn)


@pytest.mark.parametrize("options", [{"hands": "train"}, {"hands": "test", "model": "calibrated"}])
def test_horn_lag_hides_the_servo_zeros(options, opened):
    """Of a hand that keeps still only pulling tendons hold horns back."""
    env = opened(gymnasium.make_vec(ID, num_envs=8, engine="mujoco", obs="load", **options))
    env.reset(seed=0)
    episodes = env.unwrapped.episodes
    for _ in range(11):
        episodes.step(episodes.commands.last_action)
    lag = 0.1 * episodes.observe()[:, env.unwrapped.slices["horn_lag"]]
    lag[:, :5] -= episodes._camera._behind(episodes.now.state, np.arange(8))
    zero = np.array([setup.hand_settings.servo_zero for setup in episodes.setups])
    assert np.abs(zero).max() > 0.05
    np.testing.assert_allclose(lag, 0.0, atol=ServoSenses().horn_step)


def test_the_hand_hides_the_object_at_times_and_the_mask_says_so():
    with make() as env:
        seen = []
        where = env.unwrapped.slices["object_seen"]
        place = env.unwrapped.slices["object_pos"]
        for seed in range(4):
            played = islice(steps(env, Still(CLOSED), seed=seed), 1, 61)
            rows = np.array([observation for observation, *_ in played])
            hidden = rows[1:, where][:, 0] == 0
            held = (rows[1:, place] == rows[:-1, place]).all(axis=1)
            np.testing.assert_array_equal(hidden, held)  # a camera that sees has noise
            seen.append(hidden.mean())
    assert 0.1 < np.mean(seen) < 0.9


# The wrist
# -------------------------------------------------------------------------------------------------------------


def test_no_hand_starts_inside_of_anything():
    """The open hand waits, and the object stays where it stands."""
    for split in ("train", "test", "real"):
        with make(objects=split, wrist="free") as env:
            for seed in range(8):
                env.reset(seed=seed)
                rest = action_from_synergy(env.unwrapped.episodes.setups[0].synergy)
                env.action_space.seed(seed)
                choice = np.sign(env.action_space.sample()[6:])  # the corners of what can be chosen
                action = np.concatenate([rest, choice]).astype(np.float32)
                env.step(action)
                place = env.unwrapped.state.object_pos.copy()
                for _ in range(5):
                    env.step(action)
                state = env.unwrapped.state
                assert not state.touching.any(), f"{split} {seed}"
                assert np.linalg.norm(state.object_pos - place) < 2e-3, f"{split} {seed}"


def depths(envs: HandVectorEnv, other: str) -> np.ndarray:
    """How deep each hand is in the object or in its support, shape (n,) [mm]."""
    deep = np.zeros(envs.num_envs)
    for world in range(envs.num_envs):
        model, data = envs.episodes.simulation.engine.single(world)
        for contact in data.contact:
            names = {model.body(model.geom_bodyid[geom]).name for geom in contact.geom}
            if other in names and names - {"object", "support"}:
                deep[world] = max(deep[world], -1e3 * contact.dist)
    return deep


@pytest.mark.parametrize(
    ("objects", "count"),
    [
        ("real", 24),
        *(pytest.param(split, 256, marks=pytest.mark.slow) for split in ("train", "test", "real")),
    ],
)
@pytest.mark.parametrize("hands", ["train", "test"])
def test_no_other_hand_starts_inside_of_anything(objects, count, hands, opened):
    """Nor moves the object while it rests for 0.4 s. With a wrist that is placed for the nominal hand
    many do.
    """
    envs = opened(gymnasium.make_vec(ID, count, objects=objects, hands=hands))
    envs.reset(seed=BENCHMARK_SEED)
    assert not depths(envs, "support").any()
    assert depths(envs, "object").max() < 0.1
    start = envs.episodes.now.state.object_pos
    for _ in range(8):
        envs.episodes.step(envs.episodes.commands.last_action)
    moved = np.linalg.norm(envs.episodes.now.state.object_pos - start, axis=1)
    assert (moved > 2e-3).mean() <= 0.02
    envs.task.setups.reach = {}
    envs.reset(seed=BENCHMARK_SEED)
    assert (depths(envs, "support") > 0).mean() > 0.1


def test_objects_of_other_sizes_keep_their_density_and_stay_graspable():
    config = GraspAnyConfig(size=(0.7, 1.4), mass=(1.0, 1.0))
    scales = []
    task = GraspAny("real", config=config)
    poses = {
        (entry.name, pose.quaternion): pose for entry in task.setups.objects for pose in entry.poses
    }
    for seed in range(200):
        spec = (setup := task.setup(np.random.default_rng(seed))).object
        np.testing.assert_allclose(
            spec.half_extents, spec.scale * np.array(spec.model.half_extents)
        )
        assert spec.mass == pytest.approx(spec.scale**3 * spec.model.mass)
        pose = poses[spec.model.name, setup.object_quaternion]
        assert spec.scale * pose.width <= config.width[1] + 1e-9
        assert spec.scale * pose.size[2] >= config.flattest - 1e-9
        assert setup.rest_height == pytest.approx(spec.scale * pose.height)
        scales.append(spec.scale)
    assert min(scales) < 0.75
    assert max(scales) > 1.3


def test_points_that_are_seen_of_a_hidden_object_have_the_camera_s_error():
    """Against the same episodes before a camera without noise."""
    errors = []
    for noise in ({"position": 0.0}, {"position": 0.01}):
        with make(obs="points", noise=noise) as env:
            rows = []
            for seed in range(4):
                for seen, *_ in islice(steps(env, Still(CLOSED), seed=seed), 1, 51):
                    points = seen["points"]
                    hidden = seen["deploy"][env.unwrapped.slices["object_seen"]][0] == 0
                    if hidden and points[0, 3]:
                        rows.append(points[0, :3])
            errors.append(np.array(rows))
    assert len(errors[0]) > 10
    assert np.std(errors[1] - errors[0]) * LENGTH_UNIT == pytest.approx(0.01, rel=0.25)


def test_the_hand_stays_up_after_a_lift_of_any_height():
    task = GraspAny(config={"timetable": {"lift_height": 0.2}})
    times = tuple(np.arange(0.05, task.duration, 0.05).tolist())
    height = task.wrist_path(task.setup(np.random.default_rng(0)), times)[:, 2]
    assert height[-1] == pytest.approx(0.2)
    assert np.diff(height).min() > -0.021, "but for the shake"


def test_a_post_stays_where_the_wrist_is_moved():
    setup = replace(easy(), support=Support((0.03, 0.03), table_height=0.05))
    moved = placing.moved(setup, np.array([0.01, 0.0, 0.0]), 0.2)
    assert moved.support == setup.support
    assert not np.array_equal(moved.position, setup.position)


def test_the_first_action_moves_a_free_wrist_and_later_ones_do_not():
    with make(wrist="free", obs="privileged") as env:
        assert env.action_space.shape == (10,)
        for seed in range(6):
            env.reset(seed=seed)
            before = env.unwrapped.episodes.setups[0]
            rest = action_from_synergy(before.synergy)
            env.step(np.concatenate([rest, [0.2, -0.3, 0.4, 0.5]]).astype(np.float32))
            after = env.unwrapped.episodes.setups[0]
            assert after.yaw - before.yaw == pytest.approx(-0.25)
            env.step(np.concatenate([rest, [-1, -1, -1, -1]]).astype(np.float32))
            assert env.unwrapped.episodes.setups[0] is after
            world = [setup.hand_rotation @ setup.position for setup in (before, after)]
            turn = np.array(
                [[np.cos(0.25), -np.sin(0.25), 0], [np.sin(0.25), np.cos(0.25), 0], [0, 0, 1]]
            )
            moved = world[0] - turn @ world[1]
            free = [0.006, -0.009, 0.012]
            assert np.abs(moved - free).max() < 0.03, (
                "but for what the open hand must stay clear of"
            )
            assert np.allclose(moved, free) or not np.allclose(
                after.position, placing.moved(before, np.zeros(3), 0.25).position
            )


def test_a_wrist_that_is_left_alone_is_the_scripted_one():
    with make(wrist="free") as free, make() as script:
        for seed in range(3):
            np.testing.assert_array_equal(free.reset(seed=seed)[0], script.reset(seed=seed)[0])
            for _ in range(30):
                first = free.step(np.append(CLOSED, np.zeros(4, np.float32)))
                second = script.step(CLOSED)
                np.testing.assert_allclose(first[0], second[0], atol=1e-6)


@pytest.mark.parametrize("body", ["twin", "light"])
def test_episodes_have_hands_of_their_set_that_nobody_is_told(body):
    with make(hands="train", body=body) as env, make(body=body) as nominal:
        names = set()
        for seed in range(6):
            (first, _) = env.reset(seed=seed)
            (usual, _) = nominal.reset(seed=seed)
            setup = env.unwrapped.episodes.setups[0]
            names.add(setup.hand.name)
            assert any(setup.hand is variant.hand for variant in hand_set("train"))
            assert setup.hand_settings.armature == BODIES[body].armature
            assert setup.hand_settings.slack != BODIES[body].slack
            place = env.unwrapped.slices["object_pos"]  # differs with the reach of the thumb alone
            first[place] = usual[place]
            np.testing.assert_array_equal(first, usual)
        assert len(names) > 3
