"""Batches of episodes of HPAC-GraspAny-v1 for the searches of `tools`, and their success rates."""

from collections.abc import Callable, Sequence

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import checked_options
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.progress import progress
from hpac_gym.tasks.grasp_any import GraspAny, GraspAnyConfig
from hpac_gym.tasks.senses import LOAD_TERMS
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS

Act = Callable[[int, NDArray], NDArray]
"""Function from a step and the observations, shape (n, observed), to actions, shape (n, 6)."""


class Player:
    """Runs batches of n episodes of one split.

    Args:
        objects: the split.
        count: batch size n.
        hands: nominal, train or test.

    Attributes:
        task: the task; its *privileged* observation is *deploy*, then *load*, then the rest.
    """

    def __init__(self, objects: str, count: int = 64, hands: str = "nominal") -> None:
        self.name = f"{objects}-{hands}"
        self.count = count
        self.task = GraspAny(
            objects, hands=hands, config=GraspAnyConfig(side_time=0.05, ramp_time=0.05)
        )
        self.task.privileged_terms = (*LOAD_TERMS, *self.task.privileged_terms)
        self._episodes = Episodes(
            self.task, count, checked_options(obs="privileged", engine="mujoco")
        )

    def play(
        self, seeds: Sequence[int], begin: Callable[[NDArray, NDArray], Act]
    ) -> NDArray[np.bool_]:
        """Run the episodes of the seeds and return their successes, shape (len(seeds),).

        Args:
            seeds: any number of seeds.
            begin: takes the first observations of n episodes and their indices in `seeds`, and
                returns the policy for them.
        """
        won = np.zeros(len(seeds), bool)
        count = self.count
        for first in progress(range(0, len(seeds), count), "episodes"):
            part = range(first, min(first + count, len(seeds)))
            drawn = [*part, *[first] * (count - len(part))]  # surplus worlds repeat the first seed
            self._episodes.reset(
                list(range(count)), [seeding.np_random(int(seeds[place]))[0] for place in drawn]
            )
            act = begin(self._episodes.observe(), np.array(drawn))
            over = np.zeros(count, bool)
            for step in range(round(self.task.duration * CONTROL_HZ)):
                self._episodes.step(act(step, self._episodes.observe()))
                won[drawn] |= (self._episodes.outcome == SUCCESS) & ~over
                over |= self._episodes.outcome != RUNNING
                if over.all():
                    break
        return won


def rate(won: int, episodes: int) -> str:
    low, high = wilson_interval(won, episodes)
    return f"{100 * won / episodes:.1f} % [{100 * low:.1f}, {100 * high:.1f}] of {episodes}"
