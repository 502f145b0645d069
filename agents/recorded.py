"""Trials of finished runs, from which a run learns without physics: ``python -m agents.train grasp
--trials-of RUN RUN``.
"""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from agents import POLICY, RunError, target_of
from agents.recipes import Recipe
from agents.runs import latest_checkpoint
from agents.trials import Columns, Source, Trials, sizes_of
from hpac_gym.policies import Closures, read_policy
from hpac_gym.policies.policy_file import from_description

COLUMNS = tuple(Trials(0, 1, 1, 1).columns)


class Recorded(Source):
    """The trials of the runs `recipe.trials_of` in random order, without the first `done`.

    Attributes:
        steps: control steps of as many trials as `step` returns, on average.
        tried: the columns of the first `done` trials by name, which the run's checkpoints leave
            out.
        hashes: of the trials of each run, by its folder.

    Raises:
        RunError: A run is missing, damaged or of other episodes than the recipe, or there are too
            few trials.
    """

    def __init__(self, recipe: Recipe, done: int = 0) -> None:
        self.observed, self.deployed, self.phases = sizes_of(recipe)
        runs = [self._run(Path(folder), recipe) for folder in recipe.trials_of]
        self.hashes = {
            folder: sha256(b"".join(column.tobytes() for column in trials)).hexdigest()
            for folder, (trials, _) in zip(recipe.trials_of, runs, strict=True)
        }
        columns = [
            np.concatenate(parts) for parts in zip(*(trials for trials, _ in runs), strict=True)
        ]
        count = len(columns[0])
        if count < recipe.episodes:
            raise RunError(
                f"episodes is {recipe.episodes:,}: the runs have {count:,} trials together"
            )
        order = np.random.default_rng(recipe.seed).permutation(count)
        self._columns = [column[order] for column in columns]
        self._next = done
        self._chunk = recipe.num_envs
        self.tried = {
            name: column[:done] for name, column in zip(COLUMNS, self._columns, strict=True)
        }
        self.steps = round(self._chunk * sum(steps for _, steps in runs) / count)

    def _run(self, folder: Path, recipe: Recipe) -> tuple[Columns, int]:
        """The trials of a run, its set-ups told by the numbers of this recipe's, and its control
        steps.
        """
        try:
            about = read_policy(folder / POLICY).about
            with np.load(
                (latest_checkpoint(folder) or folder) / "arrays.npz", allow_pickle=False
            ) as file:
                if missing := set(COLUMNS) - set(file):
                    raise ValueError(
                        f"its checkpoint has no {', '.join(sorted(missing))}; did it learn from other runs itself?"
                    )
                seen, decisions, survived, end_state = (file[name] for name in COLUMNS)
            target = target_of(
                recipe.env_id, **recipe.options, engine=recipe.set_ups[0].partition("/")[0]
            )
            closures = from_description(Closures, about["closure"])
            if {name: about[name] for name in target} != target or closures != recipe.closures:
                raise ValueError("it is of another environment, hand or range of closures")
            ours = recipe.set_ups
            theirs = about["settings"]["set_ups"]
            if others := set(theirs) - set(ours):
                raise ValueError(f"set_ups of this run do not have its {', '.join(sorted(others))}")
        except Exception as error:  # a damaged file can make its reader raise anything
            raise RunError(f"cannot learn from the trials of '{folder}': {error}") from None
        sensed = self.observed - (len(ours) if len(ours) > 1 else 0)
        which = seen[:, sensed:].argmax(axis=1) if len(theirs) > 1 else np.zeros(len(seen), int)
        told = np.eye(len(ours), dtype=np.float32)[[ours.index(name) for name in theirs]][
            which, : self.observed - sensed
        ]
        seen, end_state = (
            np.hstack([part, told])
            for part in (seen[:, :sensed], end_state[:, : sensed - self.deployed])
        )
        return (seen, decisions, survived, end_state), about["env_steps"]

    def step(self, learner: Any, meanwhile: Callable[[], None] = lambda: None) -> Columns:
        """Call `meanwhile`; returns the next trials, as arguments of `Trials.add`."""
        meanwhile()
        rows = slice(self._next, self._next + self._chunk)
        self._next = rows.stop
        return tuple(column[rows] for column in self._columns)
