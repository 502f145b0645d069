"""`hand` is simulated, `model` is what commands and observations are computed with."""

import warnings
from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from hpac_gym.errors import WorkspaceError
from hpac_gym.model import HPAC, JOINT_INDEX, SERVOS, hand_to_toml
from hpac_gym.model.calibration import Calibration
from hpac_gym.policies.loading import load_policy

ROOTS = [JOINT_INDEX[name] for name in SERVOS]
SLACK = {"slack": (1.5e-3, 1.5e-3), "tendon_stiffness": (0.8, 0.8)}


def reached(**options) -> np.ndarray:
    """Angles of the driven joints after two seconds of a constant action [°]."""
    with gymnasium.make("HPAC-Posture-v1", engine="mujoco", **options) as env:
        env.reset(seed=0)
        for _ in range(40):
            env.step(np.full(6, -0.2, np.float32))
        return np.degrees(env.unwrapped.state.joint_pos[0, ROOTS])


@pytest.mark.parametrize(("model", "low", "high"), [(HPAC, 3.0, np.inf), ("hand", 0.0, 0.6)])
def test_a_model_that_knows_the_hand_takes_it_where_the_action_says_and_the_nominal_one_does_not(
    model, low, high
):
    asked = np.degrees(HPAC.synergy_min + 0.4 * (HPAC.synergy_max - HPAC.synergy_min))
    assert low < np.abs(reached(model=model, randomize=SLACK) - asked).mean() < high


def shown(**options) -> tuple[np.ndarray, np.ndarray]:
    """The servo angles that are commanded after a second of a constant action, and those that a
    policy sees.
    """
    with gymnasium.make("HPAC-Grasp-v0", engine="mujoco", **options) as env:
        env.reset(seed=1)
        for _ in range(20):
            seen, *_ = env.step(np.full(6, -0.2, np.float32))
        return env.unwrapped.command.servo, seen[env.unwrapped.slices["servo"]]


def test_the_nominal_model_is_the_default_whatever_hand_is_simulated():
    heavy = replace(HPAC, cmc_stiffness=1.1 * HPAC.cmc_stiffness)
    with gymnasium.make("HPAC-Grasp-v0", engine="mujoco", hand=heavy) as env:
        assert (env.unwrapped.hand, env.unwrapped.model) == (heavy, HPAC)
    np.testing.assert_array_equal(shown(hand=heavy), shown())


@pytest.fixture
def calibrated(tmp_path):
    """Path of a hand file with zeros."""
    path = tmp_path / "mine.toml"
    zeros = Calibration(servo_zero=(0.05, -0.04, 0.03, -0.02, 0.05, 0.0))
    path.write_text(hand_to_toml(replace(HPAC, name="mine", calibration=zeros)))
    return path


def test_commands_invert_the_file_and_a_policy_sees_the_same_numbers_as_on_the_nominal_hand(
    calibrated,
):
    commanded, seen = shown(model=calibrated)
    nominal, usual = shown()
    assert np.abs(commanded - nominal).max() > 0.03
    np.testing.assert_allclose(seen, usual, atol=5e-3)


@pytest.mark.parametrize("name", ["model", "hand"])
def test_a_shipped_policy_takes_a_calibrated_hand_without_a_remark(calibrated, name):
    with gymnasium.make("HPAC-Grasp-v0", **{name: calibrated}) as env:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            policy = load_policy("grasp", env)
        assert policy.predict(env.reset(seed=0)[0])[0].shape == (6,)


def test_a_refused_action_leaves_no_trace_in_the_commands_of_a_calibrated_model():
    options = {"engine": "mujoco", "hands": "test", "model": "calibrated"}
    seen = []
    with gymnasium.make("HPAC-GraspAny-v1", **options) as env:
        for wrong in ([], [np.full(6, -2.0)]):
            env.reset(seed=3)
            env.unwrapped.step(np.zeros(6))
            for action in wrong:
                with pytest.raises(WorkspaceError, match="ClipAction"):
                    env.unwrapped.step(action)
            seen.append([env.unwrapped.step(np.zeros(6))[0] for _ in range(3)])
    np.testing.assert_array_equal(*seen)


def test_the_zeros_of_a_hand_file_are_simulated_and_the_same_file_as_a_model_takes_them_out():
    zeros = Calibration(servo_zero=(-0.12,) * 5 + (0.0,))
    off = replace(HPAC, name="a tooth off", calibration=zeros)
    nominal = reached(randomize=None, model="hand")
    assert np.abs(reached(randomize=None, hand=off) - nominal)[:5].min() > 1.5
    for model in (off, "hand"):
        assert np.abs(reached(randomize=None, hand=off, model=model) - nominal).max() < 0.1
