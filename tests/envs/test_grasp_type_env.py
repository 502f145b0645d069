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
from hpac_gym.tasks.arrival import START, WRIST_CENTRE, WRIST_REACH, WRIST_TURN
from hpac_gym.tasks.grasp_type_data import GRASP_TYPES, HELD_OUT_TYPES
from hpac_gym.tasks.grasp_types import LOOK_EVERY, SETTLES
from hpac_gym.tasks.scripted import Script
from tests.envs.episodes import EASY, run
from tools.tables import DOCS

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


@pytest.mark.parametrize("engine", ENGINES)
def test_a_hand_that_arrives_in_the_object_fails_at_once(engine):
    with make(engine=engine, types="large_cylinder") as env:
        for deeper in (0.0, 0.35, 0.6):  # by so many times 65 mm
            observation, _ = env.reset(seed=2)
            first = env.unwrapped.task.script().act(observation)
            first[6] -= deeper
            *_, terminated, _, info = env.step(first)
            assert terminated == (deeper > 0)
            assert info["outcome"] == ("failure" if deeper else "running")


PLACE = [-0.21, -0.03, -0.35, 0.05, -0.06, -0.1]
"""A wrist whose hand reaches around the post of a small sphere."""


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("preshape", "seed", "clear", "beyond"),
    [
        ([-1, 1, -1, -1, 1, -1], 3, 0.3, (0.2, 0.6)),
        ([-0.88, 0.93, -0.92, -0.06, 0.69, -0.83], 0, 0.2, (-0.2, 0.1)),
    ],
    ids=["whose joint is pushed far beyond its stop", "that stays about its stop, wedged"],
)
def test_a_hand_that_arrives_with_a_digit_in_the_post_fails_at_once(
    engine, preshape, seed, clear, beyond
):
    """And one that is lower, by `clear` times 65 mm, does not."""
    for lower, over in ((0.0, True), (clear, False)):
        with make(engine=engine, types="small_sphere") as env:
            env.reset(seed=seed)
            first = np.array([*preshape, *PLACE], np.float32)
            first[8] += lower
            *_, terminated, _, info = env.step(first)
            assert terminated == over
            state = env.unwrapped.state
            assert not state.touching.any(), "only the support is in the way"
            assert info["contact_force"] == 0
            excess = np.max(state.joint_pos[0] - HPAC.joint_max)
            assert engine == "mujoco" or not over or beyond[0] < excess < beyond[1]


def test_a_hand_cannot_arrive_with_its_thumb_inside_of_a_finger():
    with make(types="large_cylinder") as env:
        for fingers, over in ((-1.0, False), (0.6, True)):
            env.reset(seed=0)
            *_, terminated, _, info = env.step(
                np.array([0.6, *[fingers] * 4, 0.5, 1, 0, 0, 0, 0, 0], np.float32)
            )
            assert terminated == over
            assert info["contact_force"] == 0


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


def test_what_the_page_says_by_hand_has_the_numbers_of_the_code():
    page = " ".join(
        (DOCS / "environments/grasp_type.md").read_text(encoding="utf-8").replace("−", "-").split()
    )
    for index, (axis, low, high) in enumerate(
        zip("xyz", WRIST_CENTRE - WRIST_REACH, WRIST_CENTRE + WRIST_REACH, strict=True)
    ):
        assert f"| {6 + index} | `grasp_{axis}` | {low:.3f} m | {high:.3f} m |" in page
    assert f"| -{WRIST_TURN:g} rad | {WRIST_TURN:g} rad |" in page
    assert f"{100 * START[0]:g} cm in front of the palm" in page
    assert f"pushes it by more than {1e3 * SETTLES:g} mm" in page
    assert LOOK_EVERY == 4
    assert "every fourth step" in page
    assert all(f"`{name}`" in page for name in HELD_OUT_TYPES)


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
