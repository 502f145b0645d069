"""What is observed, deployed, privileged and as a picture, against the state of the simulation."""

from itertools import islice

import numpy as np

from hpac_gym.envs import Grasp, HandEnv, ScriptedClosure
from hpac_gym.envs.observations import IMAGE_SIZE
from hpac_gym.model import elastic_joints_from_servo
from hpac_gym.tasks.cameras import CameraNoise
from hpac_gym.tasks.grip import MAX_SLIP
from hpac_gym.tasks.terms import GRASP_CENTRE, LENGTH_UNIT, Layout
from tests.envs.episodes import EASY, a_setup, part, steps

TERMS = Grasp().terms
DEPLOYED = Layout(TERMS, 1).space.shape[0]
STEADY = CameraNoise(position=0.0, angle=0.0, size=0.0)


def episode(env, seed: int = 0, count: int | None = None):
    """Every observation and state of one scripted episode, or of its first steps."""
    played = islice(steps(env, ScriptedClosure(), seed=seed), count)
    return zip(*((returned[0], env.unwrapped.state) for returned in played), strict=True)


def test_the_deployed_vector_holds_what_its_table_says():
    with HandEnv(Grasp(), noise=STEADY) as env:
        observation, _ = env.reset(seed=0, options={"setup": EASY})
        assert observation.shape == (DEPLOYED,)
        place = (EASY.position - GRASP_CENTRE) / LENGTH_UNIT
        extents = np.array(EASY.object.half_extents) / LENGTH_UNIT
        np.testing.assert_allclose(part(observation, TERMS, "object_pos"), place, atol=1e-4)
        np.testing.assert_allclose(part(observation, TERMS, "object_size"), extents, atol=1e-6)
        # The hand's y axis points up.
        np.testing.assert_allclose(part(observation, TERMS, "object_up"), [0, 1, 0], atol=1e-6)
        np.testing.assert_allclose(part(observation, TERMS, "down"), [0, -1, 0], atol=1e-6)
        np.testing.assert_array_equal(part(observation, TERMS, "object_side"), 0)
        np.testing.assert_array_equal(part(observation, TERMS, "object_shape"), [1, 0, 0])
        np.testing.assert_array_equal(part(observation, TERMS, "phase"), [1, 0, 0, 0])
        observation, *_ = env.step(np.zeros(6, np.float32))
        servo = env.command.servo
        np.testing.assert_allclose(part(observation, TERMS, "servo"), servo, atol=1e-6)
        np.testing.assert_allclose(
            part(observation, TERMS, "joint_pos"), elastic_joints_from_servo(servo), atol=1e-6
        )
        np.testing.assert_allclose(
            part(observation, TERMS, "progress"), 0.05 / env.task.duration, atol=1e-6
        )


def test_the_seen_joints_are_predicted_and_not_measured():
    """A blocked hand sees what it commanded: nothing in the deployed vector reads the simulated
    joints.
    """
    with HandEnv(Grasp(), noise=STEADY) as env:
        env.reset(seed=0, options={"setup": a_setup(mass=5.0, friction=1.0)})
        for _ in range(20):
            observation, *_ = env.step(np.array([0.5, 1, 1, 1, 1, 0.5], np.float32))
        seen = part(observation, TERMS, "joint_pos")
        assert np.abs(seen - env.state.joint_pos[0]).max() > 0.1
        np.testing.assert_allclose(seen, elastic_joints_from_servo(env.command.servo), atol=1e-6)


def test_all_three_show_the_same_episode_and_a_picture_changes_with_the_hand():
    seen = {}
    for obs in ("deploy", "privileged", "image"):
        with HandEnv(Grasp(), obs=obs) as env:
            seen[obs], _ = episode(env, count=20)
    for plain, more, picture in zip(*seen.values(), strict=True):
        np.testing.assert_array_equal(plain, more[:DEPLOYED])
        np.testing.assert_array_equal(plain, picture["deploy"])
    first = seen["image"][0]["image"]
    last = seen["image"][-1]["image"]
    assert first.shape == (IMAGE_SIZE, IMAGE_SIZE, 3)
    assert first.dtype == np.uint8
    assert first.std() > 10
    assert np.abs(first.astype(int) - last).mean() > 2


def test_slip_starts_when_the_hand_begins_to_carry_and_epsilon_comes_at_the_end():
    ended = []
    with HandEnv(Grasp()) as env:
        for seed in range(6):
            *before, last = (info for *_, info in steps(env, ScriptedClosure(), seed=seed))
            assert not any(
                "epsilon" in info or (info["slip"] > 0 and info["hold_time"] == 0)
                for info in before
            )
            ended.append(last)
    held = [info for info in ended if info["is_success"]]
    assert held
    assert all(0 < info["slip"] < MAX_SLIP for info in held)
    assert all(0 <= info["epsilon"] < 2 for info in ended)
    assert any(info["epsilon"] > 0 for info in held)
