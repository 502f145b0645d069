"""What HPAC-GraspAny-v1 and HPAC-GraspType-v0 pay, and what they leave to learn: `pytest -m slow -s
tests/envs/test_baselines.py` prints it.

Nothing that is no grasp is paid as well as the script, and no failure as well as a success. The script
holds some of the real objects, and closures that are drawn at random for an episode until one holds,
most of them."""

from functools import cache, partial

import gymnasium
import numpy as np
import pytest

from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.evaluation.statistics import rate_text
from hpac_gym.model import HPAC, SERVO_INDEX, action_from_synergy
from hpac_gym.policies.policy import EpisodePolicy
from hpac_gym.registration import GRASP_ANY, GRASP_TYPE
from hpac_gym.tasks.placing import WRIST_REACH
from hpac_gym.tasks.task import CONTROL_HZ
from tools.any_closures import first_winners, played as closures_played, worlds_of

pytestmark = pytest.mark.slow
TRIES = 64
EPISODES = {GRASP_ANY: 64, GRASP_TYPE: 48}
THUMB = [SERVO_INDEX["thumb_mp"], SERVO_INDEX["thumb_cmc"]]
OPEN = np.zeros(6)
OPEN[THUMB] = 0.0, 1.2
CLOSED = HPAC.synergy_max.copy()
CLOSED[THUMB] = 0.6, 1.0
FINGERS = np.array([0, 1, 1, 1, 1, 0])


def share(time: float, begin: float = 0.0) -> float:
    """Of a closure that begins at a time and takes a second [s]."""
    return min(max(time - begin, 0.0), 1.0)


def between(shares: np.ndarray | float) -> np.ndarray:
    """From open to closed, all servos alike or each by its own share."""
    return OPEN + shares * (CLOSED - OPEN)


SYNERGIES = {
    "open": lambda time: OPEN,
    "no thumb": lambda time: FINGERS * between(share(time)),
    "shelf": lambda time: OPEN + 0.7 * share(time) * FINGERS,
    "late": lambda time: between(share(time, 2.9)),
    "oscillation": lambda time: between(0.5 - 0.5 * np.cos(2 * np.pi * time)),
    "trembling": lambda time: between(share(time) * (0.8 + 0.2 * np.sin(40 * time))),
    "touch and go": lambda time: between(share(time) if time < 1.2 else 0.6),
    "pushing": lambda time: np.array([0.6, 0, 0, 0, 0, 0.78 * (1 + np.sin(4 * time))]),
}
"""Of HPAC-GraspAny-v1: synergies by the time since an episode began [s]. A shelf is bent under the object
and carries it, pushing is the thumb across the palm and back.
"""
PATHS = {
    "keeps its preshape": lambda path, step: path[0],
    "arrives open and stays open": lambda path, step: [*[-1.0] * 6, *path[0][6:]],
    "closes every digit fully": lambda path, step: path[0] if step == 0 else np.ones(12),
    "closes without the thumb": lambda path, step: [path[0][0], *path[step][1:5], *path[0][5:]],
    "closes by half": lambda path, step: path[min(step, 8)],
    "closes after the lift has begun": lambda path, step: path[max(step - 26, 0)],
    "opens before the lift": lambda path, step: path[step if step < 22 else 0],
    "opens after the shake": lambda path, step: path[step if step < 54 else 0],
    "opens and closes every second": lambda path, step: path[
        round(8 - 8 * np.cos(2 * np.pi * step / 20))
    ],
    "trembles": lambda path, step: path[step if step < 16 else 16 - 6 * (step % 2)],
    "stays 3 cm away": lambda path, step: np.minimum(
        path[step] + 0.03 / WRIST_REACH * (np.arange(12) == 6), 1
    ),
    "arrives in the object": lambda path, step: np.maximum(
        path[step] - 0.5 * (np.arange(12) == 6), -1
    ),
}
"""Of HPAC-GraspType-v0: the action at a step, made of the script's actions of the episode."""


class Behaviour(EpisodePolicy):
    """Behaves as one of `SYNERGIES` or `PATHS`."""

    def __init__(self, env: gymnasium.Env, name: str) -> None:
        self.task = env.unwrapped.task
        self.name = name

    def _act(self, observation, memory):
        path, step = memory or ([], 0)
        if self.name in SYNERGIES:
            action = action_from_synergy(SYNERGIES[self.name]((step + 1) / CONTROL_HZ))
        else:
            script = self.task.script()
            path = path or [script.act(observation) for _ in range(64)]
            action = PATHS[self.name](path, step)
        return np.asarray(action, np.float32), (path, step + 1)


def played(env_id: str, policy: str, count: int, first: int = 0, **options) -> np.ndarray:
    """Returns, successes and holding forces [N] of episodes of a policy on MuJoCo from a seed on."""
    found = evaluate(
        [policy], env_id, count, seed_start=first, options={"engine": "mujoco"} | options
    )
    (episodes,) = found.episodes.values()
    return np.array([[one.total_reward, one.success, one.holding_force or 0] for one in episodes]).T


@cache
def paid_for(env_id: str, policy: str) -> tuple[float, float, float]:
    """Mean return of training episodes, highest of a failure and lowest of a success, which are
    printed as a row of a page's table.
    """
    paid, won, _ = played(env_id, policy, EPISODES[env_id])
    told = (
        paid.mean(),
        paid[won == 0].max(initial=-np.inf),
        paid[won == 1].min(initial=np.inf),
    )
    mean, *ends = (f"{number:.1f}" for number in told)
    print("", policy.rpartition(":")[2], mean, int(won.sum()), *ends, "", sep=" | ")
    return told


@pytest.mark.parametrize(
    ("env_id", "policy"),
    [
        *((GRASP_ANY, f"{__name__}:Behaviour:{name}") for name in SYNERGIES),
        *((GRASP_TYPE, f"{__name__}:Behaviour:{name}") for name in PATHS),
        (GRASP_TYPE, "hpac_gym.policies.baselines:one_closure:rod"),
    ],
)
def test_no_behaviour_is_paid_as_well_as_the_script_and_no_failure_as_well_as_a_success(
    env_id, policy
):
    mean, best_failure, worst_success = paid_for(env_id, policy)
    honest, _, honest_success = paid_for(env_id, "scripted")
    assert mean < honest - 1
    assert best_failure < min(worst_success, honest_success)


@pytest.mark.parametrize(("objects", "most"), [("train", 0.8), ("test", 0.85), ("real", 0.6)])
def test_the_script_leaves_headroom(objects, most):
    _, won, force = played(GRASP_ANY, "scripted", 256, 1_000_000, objects=objects)
    print(f"{objects}: script {rate_text(int(won.sum()), len(won))}, force {force.mean():.1f} N")
    assert 0.35 < won.mean() < most


def test_most_real_objects_can_be_held():
    """By a closure that is drawn at random, one after the other, until one holds the object of an
    episode.
    """
    found = first_winners(partial(closures_played, worlds_of("real")), range(48), TRIES)
    print(f"real: the best of {TRIES} closures holds {len(found)} of 48")
    assert len(found) >= 0.85 * 48
