"""The three observations of one episode."""

import gymnasium
import numpy as np
import pybullet
import pytest

import hpac_gym  # noqa: F401  registers the environments
from hpac_gym.envs import Grasp, HandEnv, ScriptedClosure
from hpac_gym.envs.grip import MAX_SLIP
from hpac_gym.envs.observation import FIELDS, GRASP_CENTRE, LENGTH_UNIT
from hpac_gym.envs.views import FORCE_UNIT, IMAGE_SIZE, PARTS, PRIVILEGED_FIELDS
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC
from hpac_gym.sim.truth import object_velocity

DEPLOYED = sum(len(field.labels) for field in FIELDS)


def episode(obs: str, seed: int = 0):
    """Every observation of one scripted episode, its last info, and the environment."""
    env = HandEnv(Grasp(), obs=obs)
    policy, seen, over = ScriptedClosure(), [env.reset(seed=seed)[0]], False
    policy.reset()
    while not over:
        observation, _, over, _, info = env.step(policy.act(seen[-1]))
        seen.append(observation)
    return seen, info, env


def truth(observation: np.ndarray, name: str) -> np.ndarray:
    start = DEPLOYED
    for field in PRIVILEGED_FIELDS:
        if field.name == name:
            return observation[start : start + len(field.labels)]
        start += len(field.labels)
    raise KeyError(name)


def test_all_three_show_the_same_episode():
    deployed, *_ = episode("deploy")
    privileged, *_ = episode("privileged")
    pictured, *_ = episode("image")
    assert len(deployed) == len(privileged) == len(pictured)
    for plain, more, picture in zip(deployed, privileged, pictured, strict=True):
        np.testing.assert_array_equal(plain, more[:DEPLOYED])
        np.testing.assert_array_equal(plain, picture["deploy"])


def test_the_privileged_part_is_the_simulation_s_own():
    seen, _, env = episode("privileged", seed=2)
    scene, last = env.scene, seen[-1]
    np.testing.assert_allclose(truth(last, "true_joint_pos"), scene.hand.joint_pos, atol=1e-6)
    forces = scene.contact_forces()
    np.testing.assert_allclose(truth(last, "contact_force") * FORCE_UNIT, [forces.get(part, 0) for part in PARTS], atol=1e-4)
    assert truth(last, "object_mass")[0] == pytest.approx(scene.object.spec.mass)
    assert truth(last, "object_friction")[0] == pytest.approx(0.9 * scene.object.spec.friction)
    place = truth(seen[0], "true_object_pos") * LENGTH_UNIT + GRASP_CENTRE
    env.reset(seed=2)
    np.testing.assert_allclose(place, scene.object_pose()[0], atol=1e-6)
    assert np.abs([truth(row, "tension").max() for row in seen]).max() > 0
    assert np.all(truth(last, "horn") <= HPAC.servo_max + 1e-6)
    env.close()


def test_the_object_s_velocity_is_given_along_the_axes_of_the_hand():
    env = HandEnv(Grasp())
    env.reset(seed=2)
    scene = env.scene
    pybullet.resetBaseVelocity(scene.object.body, [0.1, 0.2, 0.3], [1.0, 2.0, 3.0], physicsClientId=scene.world.client)
    linear, angular = object_velocity(scene)
    np.testing.assert_allclose(linear, [0.2, 0.3, 0.1], atol=1e-9)  # the hand's z is the world's x, its x the world's y
    np.testing.assert_allclose(angular, [2.0, 3.0, 1.0], atol=1e-9)
    env.close()


def test_the_picture_shows_the_hand_and_changes_with_it():
    seen, _, env = episode("image")
    first, last = seen[0]["image"], seen[-1]["image"]
    assert first.shape == (IMAGE_SIZE, IMAGE_SIZE, 3)
    assert first.dtype == np.uint8
    assert first.std() > 10
    assert np.abs(first.astype(int) - last).mean() > 2
    env.close()


def test_an_unknown_view_is_named():
    with pytest.raises(ParameterError, match="everything"):
        gymnasium.make("HPAC-Grasp-v0", obs="everything")


def test_slip_starts_when_the_hand_begins_to_carry_and_epsilon_comes_at_the_end():
    env = HandEnv(Grasp())
    policy, ended = ScriptedClosure(), []
    for seed in range(6):
        observation, info = env.reset(seed=seed)
        policy.reset()
        over = False
        while not over:
            assert "epsilon" not in info
            assert info["slip"] == 0.0 or info["hold_time"] > 0
            observation, _, over, _, info = env.step(policy.act(observation))
        ended.append(info)
    held = [info for info in ended if info["is_success"]]
    assert held
    assert all(0 < info["slip"] < MAX_SLIP for info in held)
    assert all(0 <= info["epsilon"] < 2 for info in ended)
    assert any(info["epsilon"] > 0 for info in held)
    env.close()
