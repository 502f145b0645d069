"""Baselines of HPAC-GraspType-v0: ``python -m tools.type_baselines`` prints the table of its page.

One closure for all types is that of the sixteen types' own that wins most episodes of all training types, on seeds that nothing
else uses. All are judged on held-out seeds.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hpac_gym.envs import GraspByType, HandVectorEnv
from hpac_gym.evaluation.seeds import HELD_OUT_SEED
from hpac_gym.evaluation.statistics import wilson_interval
from hpac_gym.model import action_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.progress import progress
from hpac_gym.tasks.grasp_types import GRASP_TYPES, wrist_choice
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS

SEARCH_SEED = 6_000_000
"""First seed on which a closure for all types is chosen."""
TRIES = 24
"""Episodes of each closure that may be chosen."""
CELLS = {
    "training types and objects": ("train", "train"),
    "held-out objects": ("train", "test"),
    "held-out types": ("test", "train"),
    "both": ("test", "test"),
}
"""Types and objects that are reported apart."""
WORLDS = 64


@dataclass(frozen=True, slots=True)
class Closing:
    """From one shape of the hand to another at one speed."""

    begin: Array
    """Synergy in which the hand arrives, shape (6,) [rad]."""
    end: Array
    """Shape (6,) [rad]."""
    wrist: Array | None = None
    """Where the wrist goes, as the first action says it, shape (6,); None is the type's own place."""

    def action(self, step: int, name: str) -> Array:
        """The action of a control step, counted from 0, for a type, shape (12,)."""
        share = min(step / CONTROL_HZ / CLOSE_TIME, 1.0)
        wrist = wrist_choice(GRASP_TYPES[name].start) if self.wrist is None else self.wrist
        return np.append(action_from_synergy(self.begin + share * (self.end - self.begin)), wrist)


Act = Callable[[int, list[str]], Array]
"""Actions of a step, counted from 0, for the types that are asked for, shape (n, 12)."""


def own(step: int, names: list[str]) -> Array:
    """Each type's own closure."""
    starts = [GRASP_TYPES[name].start for name in names]
    return np.array([Closing(start.preshape, start.closed).action(step, start.name) for start in starts])


def alike(closing: Closing) -> Act:
    """One closure for all types."""
    return lambda step, names: np.array([closing.action(step, name) for name in names])


def at_random(seed: int) -> Act:
    """Uniform actions, anew at every step."""
    rng = np.random.default_rng(seed)
    return lambda step, names: rng.uniform(-1, 1, (len(names), 12))


def play(types: str, objects: str, seeds: Sequence[int], act: Act, **options: str) -> NDArray[np.bool_]:
    """Whether the episodes of these seeds are won."""
    n = min(WORLDS, len(seeds))
    envs, won = HandVectorEnv(GraspByType(types, objects), n, "Disabled", **{"engine": "mujoco"} | options), []
    for first in range(0, len(seeds), n):
        part = list(seeds[first : first + n])
        envs.reset(seed=part + part[:1] * (n - len(part)))
        names = [setup.grasp for setup in envs.episodes.setups]
        over, success, step = np.zeros(n, bool), np.zeros(n, bool), 0
        while not over.all():
            envs.episodes.step(act(step, names))
            success |= ~over & (envs.episodes.outcome == SUCCESS)
            over |= envs.episodes.outcome != RUNNING
            step += 1
        won += success[: len(part)].tolist()
    envs.close()
    return np.array(won)


def chosen(among: Sequence[Closing], about: str) -> Closing:
    """The one that wins most episodes of training types and objects."""
    seeds = range(SEARCH_SEED, SEARCH_SEED + TRIES)
    shown = progress(list(among), about, sys.stderr.isatty())
    return max(shown, key=lambda closing: play("train", "train", seeds, alike(closing)).sum())


def main() -> None:
    """Choose, judge, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-n", "--episodes", type=int, default=100, help="of each policy in each cell (default: %(default)s)")
    parser.add_argument("--engine", default="mujoco")
    parser.add_argument("--body", default="twin")
    parser.add_argument("--randomize", default="nominal")
    options = parser.parse_args()
    closures = [Closing(kind.start.preshape, kind.start.closed) for kind in GRASP_TYPES.values()]
    fixed = [replace(one, wrist=wrist_choice(kind.start)) for one, kind in zip(closures, GRASP_TYPES.values(), strict=True)]
    policies = {
        "each type's own wrist and closure": own,
        "each type's own wrist, one closure for all": alike(chosen(closures, "closures")),
        "one wrist and one closure for all": alike(chosen(fixed, "wrists")),
        "random actions": at_random(0),
    }
    where = {"engine": options.engine, "body": options.body, "randomize": options.randomize}
    seeds = range(HELD_OUT_SEED, HELD_OUT_SEED + options.episodes)
    print(f"| {' | '.join(['policy', *CELLS])} |\n{'| --- ' * (1 + len(CELLS))}|")
    for name, act in policies.items():
        cells = []
        for types, objects in CELLS.values():
            won = play(types, objects, seeds, act, **where)
            low, high = wilson_interval(int(won.sum()), len(won))
            cells.append(f"{won.mean():.1%} ({low:.1%} … {high:.1%})")
        print(f"| {' | '.join([name, *cells])} |", flush=True)


if __name__ == "__main__":
    main()
