"""What HPAC-GraspAny-v1 pays, and what it leaves to learn: `pytest -m slow -s
tests/envs/test_grasp_any_baselines.py` prints it.

Nothing that is no grasp is paid as well as an honest closure; the script holds some of the real
objects, and closures that are drawn at random for an episode until one holds, most of them."""

from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest

from hpac_gym.evaluation.evaluate import evaluate
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.model import HPAC, SERVO_INDEX, action_from_synergy
from hpac_gym.policies.policy import EpisodePolicy
from hpac_gym.registration import GRASP_ANY
from hpac_gym.tasks.task import CONTROL_HZ
from tools.any_closures import Player, first_winners

TRIES = 64
OPEN = np.zeros(6)
OPEN[SERVO_INDEX["thumb_cmc"]] = 1.2
CLOSED = HPAC.synergy_max.copy()
CLOSED[[SERVO_INDEX["thumb_mp"], SERVO_INDEX["thumb_cmc"]]] = 0.6, 1.0
FINGERS = slice(1, 5)


def share(time: float, begin: float = 0.0, duration: float = 1.0) -> float:
    """Of a closure that begins at a time and takes a duration [s]."""
    return min(max((time - begin) / duration, 0.0), 1.0)


def between(shares: np.ndarray | float) -> np.ndarray:
    """From open to closed, all servos alike or each by its own share."""
    return OPEN + shares * (CLOSED - OPEN)


def thumbless(time: float) -> np.ndarray:
    """The fingers press the object against the palm, the thumb lies aside."""
    synergy = between(share(time))
    synergy[[SERVO_INDEX["thumb_mp"], SERVO_INDEX["thumb_cmc"]]] = 0.0
    return synergy


def shelf(time: float) -> np.ndarray:
    """The fingers are bent under the object and carry it from below, the thumb stays open."""
    synergy = OPEN.copy()
    synergy[FINGERS] = 0.7 * share(time)
    return synergy


def sweep(time: float) -> np.ndarray:
    """The thumb pushes the object away, across the palm and back."""
    synergy = OPEN.copy()
    synergy[SERVO_INDEX["thumb_cmc"]] = 0.78 * (1 + np.sin(4 * time))
    synergy[SERVO_INDEX["thumb_mp"]] = 0.6
    return synergy


EXPLOITS = {
    "open": lambda time: OPEN,
    "no thumb": thumbless,
    "shelf": shelf,
    "late": lambda time: between(share(time, 2.9)),
    "oscillation": lambda time: between(0.5 - 0.5 * np.cos(2 * np.pi * time)),
    "trembling": lambda time: between(share(time) * (0.8 + 0.2 * np.sin(40 * time))),
    "touch and go": lambda time: between(share(time) if time < 1.2 else 0.6),
    "pushing": sweep,
}
"""Synergies by the time since an episode began [s]."""


class Exploit(EpisodePolicy):
    """Moves as one of `EXPLOITS`."""

    def __init__(self, env: gymnasium.Env, name: str) -> None:
        self.synergy = EXPLOITS[name]

    def _act(self, observation, memory):
        step = (memory or 0) + 1
        return action_from_synergy(self.synergy(step / CONTROL_HZ)), step


def played(policy: str, count: int, first: int = 0, objects: str = "train") -> Iterator[np.ndarray]:
    """Returns, successes and holding forces [N] of episodes of a policy from a seed on."""
    options = {"engine": "mujoco", "objects": objects}
    found = evaluate([policy], GRASP_ANY, count, seed_start=first, options=options)
    (episodes,) = found.episodes.values()
    for name in ("total_reward", "success", "holding_force"):
        yield np.array([getattr(episode, name) for episode in episodes])


@pytest.fixture(scope="module")
def honest():
    """Returns and successes of the scripted closure on training objects."""
    paid, won, _ = played("scripted", 64)
    return paid, won


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPLOITS)
def test_no_exploit_is_paid_as_well_as_an_honest_closure(name, honest):
    paid, won, _ = played(f"{__name__}:Exploit:{name}", 64)
    for about, (total, successes) in ((name, (paid, won)), ("honest", honest)):
        print(f"{about}: return {total.mean():.2f}, success {successes.mean():.2f}")
    assert paid.mean() < honest[0].mean() - 1.0
    assert paid[~won].max(initial=-9.0) < honest[0][honest[1]].min(), (
        "a loss is paid less than any success"
    )


@pytest.mark.slow
@pytest.mark.parametrize(("objects", "most"), [("train", 0.8), ("test", 0.85), ("real", 0.6)])
def test_the_script_leaves_headroom(objects, most):
    _, won, force = played("scripted", 256, 1_000_000, objects)
    low, high = wilson_interval(int(won.sum()), len(won))
    print(
        f"{objects}: script {won.mean():.3f} [{low:.3f}, {high:.3f}] of {len(won)}, holding force {force.mean():.1f} N"
    )
    assert 0.35 < won.mean() < most


@pytest.mark.slow
def test_most_real_objects_can_be_held():
    """By a closure that is drawn at random, one after the other, until one holds the object of an
    episode.
    """
    found = first_winners(Player("real"), range(48), TRIES)
    print(f"real: the best of {TRIES} closures holds {len(found)} of 48")
    assert len(found) >= 0.85 * 48
