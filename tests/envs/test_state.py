"""`save_state` and `restore_state`: the same actions from a saved state give the same steps, to the
bit.
"""

import gymnasium
import numpy as np
import pytest

from hpac_gym.envs.snapshots import undeclared
from hpac_gym.errors import EpisodeError
from hpac_gym.physics.simulation import ENGINES
from hpac_gym.registration import GENTLE, GRASP, GRASP_ANY, GRASP_TYPE, PICK_PLACE, POSTURE
from hpac_gym.tasks.grasp_rules import GRASP_TYPES
from hpac_gym.tasks.placing import wrist_choice


def closing(env: gymnasium.Env, steps: int, rng: np.random.Generator) -> np.ndarray:
    """A hand that closes with some noise, which touches, pushes and sometimes holds. A free wrist
    is at its type's place, or anywhere.
    """
    share = np.clip(np.arange(1, steps + 1) / 14, 0, 1)[:, None]
    goal = np.array([0.3, 1, 1, 1, 1, 0.5])
    action = -1 + share * (goal + 1) + rng.uniform(-0.2, 0.2, (steps, 6))
    action[:, 5] = 0.5
    more = env.action_space.shape[0] - 6
    place = np.full(more, 0.5) if more < 6 else wrist_choice(GRASP_TYPES["large_cylinder"].start)
    whole = np.concatenate([np.clip(action, -1, 1), np.tile(place, (steps, 1))], axis=1)
    return whole.astype(np.float32)


def told(env: gymnasium.Env, actions: np.ndarray) -> list:
    """What the steps return, until the episode is over."""
    rows = []
    for action in actions:
        rows.append(env.step(action))
        if rows[-1][2]:
            break
    return rows


@pytest.mark.parametrize(
    ("name", "engine", "options", "steps"),
    [
        *((GRASP, engine, {"obs": "privileged", "randomize": "full"}, 48) for engine in ENGINES),
        (
            GRASP_ANY,
            "mujoco",
            {"obs": "load", "wrist": "free", "hands": "train", "model": "hand"},
            14,
        ),
        (GRASP_TYPE, "pybullet", {"types": "large_cylinder"}, 48),
        (PICK_PLACE, "mujoco", {"randomize": "link"}, 40),
        (POSTURE, "mujoco", {}, 12),
    ],
    ids=str,
)
def test_the_same_actions_from_a_saved_state_give_the_same_steps_to_the_bit(
    name, engine, options, steps, opened
):
    """Saved at the start, in contact and while lifting; each restored after another future, from
    which it has to come back.
    """
    env = opened(gymnasium.make(name, engine=engine, **options)).unwrapped
    rng = np.random.default_rng(3)
    actions = closing(env, steps, rng)
    env.reset(seed=5)
    saved = [(0, env.save_state())]
    begun = env.episodes.observe()
    rows = []
    for number, action in enumerate(actions, 1):
        rows.append(env.step(action))
        if rows[-1][2]:
            break
        if number in (11, 26, 38):
            saved.append((number, env.save_state()))
    for number, state in (*reversed(saved), saved[0]):
        env.restore_state(state)
        if number == 0:
            np.testing.assert_equal(env.episodes.observe(), begun)
        told(env, rng.uniform(-1, 1, (4, *env.action_space.shape)).astype(np.float32))
        env.restore_state(state)
        np.testing.assert_equal(
            told(env, actions[number : number + 10]), rows[number : number + 10]
        )


def test_a_state_of_another_episode_or_environment_is_refused(opened):
    env, other = (opened(gymnasium.make(GRASP)).unwrapped for _ in range(2))
    with pytest.raises(EpisodeError, match="reset"):
        env.save_state()
    env.reset(seed=0)
    other.reset(seed=0)
    state = env.save_state()
    env.restore_state(state)
    env.reset(seed=0)
    for refused, given in ((other, state), (env, state), (env, None)):
        with pytest.raises(EpisodeError, match="only in the episode"):
            refused.restore_state(given)
    env.close()
    with pytest.raises(EpisodeError, match="closed"):
        env.restore_state(state)


def test_nothing_is_saved_of_a_hand_at_the_far_end_of_a_wire(opened):
    env = opened(gymnasium.make(POSTURE, transmit=lambda command: command)).unwrapped
    env.reset(seed=0)
    with pytest.raises(EpisodeError, match="transmit"):
        env.save_state()


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (GRASP, {"obs": "privileged", "randomize": "full"}),
        (GRASP, {"grasp": "tip_pinch"}),
        (GRASP_ANY, {"obs": "load", "wrist": "free", "hands": "train"}),
        (GRASP_ANY, {"obs": "points", "hands": "test", "model": "calibrated"}),
        (GRASP_TYPE, {"types": "large_cylinder"}),
        (GENTLE, {"obs": "load"}),
        (PICK_PLACE, {"randomize": "link"}),
        (POSTURE, {}),
    ],
    ids=str,
)
def test_everything_that_changes_in_an_episode_is_declared(name, options):
    with gymnasium.make(name, engine="mujoco", **options) as env:
        env.reset(seed=5)
        actions = closing(env, 60, np.random.default_rng(3))
        assert undeclared(env.unwrapped.episodes, lambda: told(env, actions)) == []
