"""What HPAC-GraspAny-v1 pays, and what it leaves to learn: `pytest -m slow -s
tests/envs/test_grasp_any_baselines.py` prints it.

Nothing that is no grasp is paid as well as an honest closure; the script holds some of the real
objects, and closures that are drawn at random for an episode until one holds, most of them."""

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from hpac_gym.envs import GraspAny, HandVectorEnv
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.model import HPAC, SERVO_INDEX, action_from_synergy
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS
from tools.any_closures import Player, first_winners

N = 64
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


class Hands:
    """`N` episodes at a time of one split.

    Attributes:
        total: their returns.
        won: whether they are won.
        force: their holding forces [N].
    """

    def __init__(self, objects: str) -> None:
        self.task = GraspAny(objects)
        self.envs = HandVectorEnv(self.task, N, "Disabled", engine="mujoco")

    def play(self, seeds: Sequence[int], act: Callable[[int, np.ndarray], np.ndarray]) -> "Hands":
        """Play the episodes of `N` seeds with the actions, shape (N, 6), of a step and the first
        observations.
        """
        first, _ = self.envs.reset(seed=list(seeds))
        episodes = self.envs.episodes
        over = np.zeros(N, bool)
        self.total = np.zeros(N)
        self.force = np.zeros(N)
        self.won = np.zeros(N, bool)
        for step in range(round(self.task.duration * CONTROL_HZ)):
            self.total += np.where(over, 0.0, episodes.step(act(step, first)))
            ended = (episodes.outcome != RUNNING) & ~over
            self.won |= ended & (episodes.outcome == SUCCESS)
            self.force[ended] = episodes.task.report(episodes.now)["holding_force"][ended]
            over |= ended
        assert over.all()
        return self

    def play_script(self, seeds: Sequence[int]) -> "Hands":
        """Play episodes with the scripted closure."""
        scripts = [self.task.script() for _ in seeds]
        for script in scripts:
            script.reset()
        return self.play(
            seeds,
            lambda _, first: np.array(
                [one.act(row) for one, row in zip(scripts, first, strict=True)]
            ),
        )


@pytest.fixture(scope="module")
def honest():
    """The scripted closure on training objects."""
    hands = Hands("train").play_script(range(N))
    hands.envs.close()
    return hands


@pytest.mark.slow
@pytest.mark.parametrize("name", EXPLOITS)
def test_no_exploit_is_paid_as_well_as_an_honest_closure(name, honest):
    synergy = EXPLOITS[name]
    hands = Hands("train")
    hands.play(
        range(N),
        lambda step, _: np.tile(action_from_synergy(synergy((step + 1) / CONTROL_HZ)), (N, 1)),
    )
    hands.envs.close()
    for about, found in ((name, hands), ("honest", honest)):
        print(f"{about}: return {found.total.mean():.2f}, success {found.won.mean():.2f}")
    assert hands.total.mean() < honest.total.mean() - 1.0
    assert hands.total[~hands.won].max(initial=-9.0) < honest.total[honest.won].min(), (
        "a loss is paid less than any success"
    )


@pytest.mark.slow
@pytest.mark.parametrize(("objects", "most"), [("train", 0.8), ("test", 0.85), ("real", 0.6)])
def test_the_script_leaves_headroom(objects, most):
    hands = Hands(objects)
    won = []
    force = []
    for first in range(1_000_000, 1_000_000 + 4 * N, N):
        hands.play_script(range(first, first + N))
        won = [*won, *hands.won]
        force = [*force, *hands.force]
    hands.envs.close()
    low, high = wilson_interval(int(np.sum(won)), len(won))
    print(
        f"{objects}: script {np.mean(won):.3f} [{low:.3f}, {high:.3f}] of {len(won)}, holding force {np.mean(force):.1f} N"
    )
    assert 0.35 < np.mean(won) < most


@pytest.mark.slow
def test_most_real_objects_can_be_held():
    """By a closure that is drawn at random, one after the other, until one holds the object of an
    episode.
    """
    found = first_winners(Player("real"), range(48), TRIES)
    print(f"real: the best of {TRIES} closures holds {len(found)} of 48")
    assert len(found) >= 0.85 * 48
