"""HPAC-GraspType-v0: one start, the first action, the type that is told and judged. The contract is
in test_gate.py.
"""

from collections.abc import Callable
from functools import partial
from unittest.mock import Mock

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs import GraspTypeSetup
from hpac_gym.errors import ParameterError
from hpac_gym.model import HPAC
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.tasks.grasp_rules import GRASP_TYPES
from hpac_gym.tasks.grasp_types import LOOK_EVERY
from hpac_gym.tasks.scripted import Script
from tests.envs.episodes import EASY, run

ID = "HPAC-GraspType-v0"
make = partial(gymnasium.make, ID)


class Changed(Script):
    """The script of an environment, for one episode, with actions that are changed."""

    def __init__(self, env: gymnasium.Env, change: Callable[[np.ndarray, int], np.ndarray]) -> None:
        self.script = env.unwrapped.task.script()
        self.change = change
        self.step = 0

    def act(self, observation: np.ndarray) -> np.ndarray:
        self.step += 1
        return self.change(self.script.act(observation), self.step)


@pytest.mark.parametrize("engine", ENGINES)
def test_each_type_s_own_closure_is_held_and_kept_and_a_hand_that_opens_at_the_end_is_neither(
    engine,
):
    with make(engine=engine, types=["large_cylinder", "hook", "lateral_pinch"]) as env:
        names = set()
        for seed in (0, 1):
            infos, _ = run(env, env.unwrapped.task.script(), seed=seed)
            assert infos[-1]["is_success"]
            assert infos[-1]["held"]
            assert (infos[-1]["kept"], infos[-1]["missed"]) == (1.0, "")
            assert not any(info["held"] for info in infos[:-1])
            names.add(infos[0]["type"])
        assert len(names) > 1
        opened = Changed(
            env,
            lambda action, step: action if step < 60 else np.append(np.full(6, -1), action[6:]),
        )
        (*_, last), _ = run(env, opened, seed=0)
        assert not last["is_success"]
        assert not last["held"]


def test_what_is_held_otherwise_than_the_type_asks_is_no_success():
    """A baton is held with index and pinky aside, and by its own closure: the same object, the same
    start, another outcome.
    """

    def two_fingers(action, step):
        return np.where(np.isin(np.arange(12), [1, 4]), -1.0, action).astype(np.float32)

    with make(types="small_cylinder") as env:
        (*_, lost), unpaid = run(env, Changed(env, two_fingers), seed=1)
        (*_, won), paid = run(env, env.unwrapped.task.script(), seed=1)
    assert won["is_success"]
    assert lost["held"]
    assert not lost["is_success"]
    assert lost["missed"] == "3 fingers touch"
    assert 0.5 < lost["kept"] < 1
    assert unpaid < paid - 10


PLACE = [-0.21, -0.03, -0.35, 0.05, -0.06, -0.1]
"""A wrist whose hand reaches around the post of a small sphere."""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("types", "seed", "action", "moved", "fates", "beyond"),
    [
        ("large_cylinder", 2, None, 6, {0.0: False, -0.35: True, -0.6: True}, None),
        ("small_sphere", 3, [-1, 1, -1, -1, 1, -1, *PLACE], 8, {0.3: False, 0.0: True}, (0.2, 0.6)),
        (
            "small_sphere",
            0,
            [-0.88, 0.93, -0.92, -0.06, 0.69, -0.83, *PLACE],
            8,
            {0.2: False, 0.0: True},
            (-0.2, 0.1),
        ),
        (
            "large_cylinder",
            0,
            [0.6, -1, -1, -1, -1, 0.5, 1, 0, 0, 0, 0, 0],
            slice(1, 5),
            {0.0: False, 1.6: True},
            None,
        ),
    ],
    ids=[
        "in the object",
        "with a digit in the post, whose joint is pushed far beyond its stop",
        "with a digit in the post, that stays about its stop, wedged",
        "with its thumb in a finger",
    ],
)
def test_a_hand_that_arrives_in_something_fails_at_once(
    engine, types, seed, action, moved, fates, beyond
):
    """And one with another place, by so many times 65 mm, or with straight fingers, does not."""
    with make(engine=engine, types=types) as env:
        for change, over in fates.items():
            observation, _ = env.reset(seed=seed)
            first = np.array(action or env.unwrapped.task.script().act(observation), np.float32)
            first[moved] += change
            *_, terminated, _, info = env.step(first)
            assert terminated == over
            assert info["outcome"] == ("failure" if over else "running")
            assert action is None or info["contact_force"] == 0, "only the object is touched"
        excess = np.max(env.unwrapped.state.joint_pos[0] - HPAC.joint_max)
        assert engine == "mujoco" or beyond is None or beyond[0] < excess < beyond[1]


def test_only_the_first_action_moves_the_wrist_and_shapes_the_hand_at_once():
    with make(types="rod") as env:
        env.reset(seed=0)
        begun = env.unwrapped.episodes.setups[0]
        action = np.array([0.5, -1, 0, -1, -1, 0.8, 1, 0, 0.2, -0.2, 0.3, 0.1], np.float32)
        env.step(action)
        setup = env.unwrapped.episodes.setups[0]
        assert setup is not begun
        np.testing.assert_allclose(
            env.unwrapped.episodes.commands.last_action[0], action[:6], atol=1e-6
        )
        np.testing.assert_allclose(setup.synergy[0], 0.75 * 1.25, rtol=0.1)
        env.step(-action)
        assert env.unwrapped.episodes.setups[0] is setup


def test_a_policy_is_told_its_type_in_every_step():
    with make() as env:
        place = env.unwrapped.slices["type"]
        told = set()
        for seed in range(40):
            observation, info = env.reset(seed=seed)
            assert observation[place].sum() == 1
            assert list(GRASP_TYPES)[observation[place].argmax()] == info["type"]
            told.add(info["type"])
        after, *_ = env.step(env.action_space.sample())
    np.testing.assert_array_equal(after[place], observation[place])
    assert len(told) > 10


def test_an_episode_that_is_given_names_its_type():
    with make() as env:
        with pytest.raises(
            ParameterError, match="setup grasp None is not one of large_cylinder, small_cylinder"
        ):
            env.reset(options={"setup": EASY})
        _, info = env.reset(options={"setup": EASY.to(GraspTypeSetup, grasp="small_cylinder")})
        assert info["type"] == "small_cylinder"


def test_contacts_are_looked_at_often_enough_to_judge_a_hold_and_no_oftener(monkeypatch):
    with make(types="large_cylinder") as env:
        engine = env.unwrapped.episodes.simulation.engine
        looks = Mock(wraps=engine.contacts)
        monkeypatch.setattr(engine, "contacts", looks)
        infos, _ = run(env, env.unwrapped.task.script(), seed=0)
    assert infos[-1]["is_success"]
    times = env.unwrapped.task.timetable.ends
    # The last one is of the grasp's quality.
    assert looks.call_count == (round(20 * (times[3] - times[1])) - 1) // LOOK_EVERY + 3
