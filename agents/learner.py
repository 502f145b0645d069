"""One-step soft actor-critic (SAC) for a contextual bandit: the context is the first observation of
an episode, the arm is a closure of the hand, and the return is whether the episode succeeds.

The critics are a survival model with an auxiliary loss: they observe the full simulation state and
predict for each of the task's phases the hazard, whether a closure that reached it survives it, and
the simulation state at the end of the closing. The actor observes only what a real hand has. As in
SAC it maximises the log-probability of success, pessimistic where the critics disagree, plus alpha
times its entropy, where alpha follows a target entropy that falls during the training. There is no
bootstrapping and no target network, since an episode is one decision. All trials so far are
replayed; episodes of near-certain success are accepted with a smaller probability.
`docs/learning.md` has the reasons.

Where random closures hardly ever succeed, the first trials are drawn about the task's script, and
the actor maximises the likelihood of the trials that succeeded instead; the critics then only
choose the episodes."""

from collections import defaultdict

import numpy as np
import torch
from torch.nn import functional

from agents import RunError
from agents.networks import Networks, descend, scaled
from agents.recipes import Recipe
from agents.trials import Trials
from hpac_gym.model import action_from_synergy
from hpac_gym.policies import Closures
from hpac_gym.registration import GRASP_TYPE
from hpac_gym.tasks.grasp_rules import GRASP_TYPES
from hpac_gym.tasks.grasp_types import GraspByType
from hpac_gym.tasks.placing import wrist_choice
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ
from hpac_gym.tasks.terms import Layout

TYPE = Layout(GraspByType().terms, 1).slices["type"]
"""Entries of an observation of HPAC-GraspType-v0 with the type's name. The networks do not see
them: the rest of the observation contains the type's rule, which also describes unseen types."""
SURE = 0.7  # predicted success above which a trial may be rejected
MOST = 0.98  # bound of the first decisions about a script, where the actor's tanh can imitate them


class Learner:
    """Critics, an actor, and the trials that they are fitted to; `observed`, `deployed` and
    `phases` are those of `Worlds`.
    """

    def __init__(self, recipe: Recipe, observed: int, deployed: int, phases: int) -> None:
        self._recipe = recipe
        self._deployed = deployed
        self._phases = torch.arange(phases)
        decided = len(recipe.closures.names)
        self.reseed(recipe.seed)
        self.trials = Trials(recipe.episodes, observed, deployed, decided)
        self.networks = Networks(recipe, observed, deployed, phases)
        self.updates = 0
        self.entropy = float("nan")
        self._noted: defaultdict[str, list[float]] = defaultdict(list)

    def reseed(self, seed: int) -> None:
        """Seed all random numbers."""
        torch.manual_seed(seed)
        self._rng = np.random.default_rng(seed)

    @torch.no_grad()
    def decide(self, seen: np.ndarray) -> np.ndarray:
        """Decisions to try, shape (n, m), for first observations, shape (n, observed); random
        before the first update.
        """
        if self.updates:
            shown = self.networks.scaled(seen)[:, : self._deployed]
            return self.networks.actor(shown)[0].numpy().astype(float)
        if not self._recipe.script_std:
            return self._rng.uniform(-1.0, 1.0, (len(seen), self.trials.decisions.shape[1]))
        widths = self._recipe.script_std * 10.0 ** self._rng.uniform(-1, 0, (len(seen), 1))
        drawn = scripted_decisions(self._recipe.closures, seen)
        return np.clip(drawn + widths * self._rng.standard_normal(drawn.shape), -MOST, MOST)

    @torch.no_grad()
    def predicted(self, seen: np.ndarray, decisions: np.ndarray) -> np.ndarray:
        """Success probability of trials predicted by the critics, shape (n,)."""
        decided = torch.from_numpy(decisions.astype(np.float32))
        return self.networks.success(self.networks.scaled(seen), decided).mean(0).exp().numpy()

    def add(self, *trials: np.ndarray) -> None:
        """Add trials, as arguments of `Trials.add`."""
        seen, decisions, survived, _ = trials
        if self.updates and len(seen):
            held = survived == len(self._phases)
            self._note(brier_score=np.mean((self.predicted(seen, decisions) - held) ** 2))
        self.trials.add(*trials)

    def metrics(self) -> dict[str, float]:
        """Means since the last call: losses, entropy and its target, alpha, share of the episodes
        that were accepted, and Brier score of the predictions for new trials, which are harder
        than those that were rejected.
        """
        means = {name: sum(values) / len(values) for name, values in self._noted.items()}
        self._noted.clear()
        return means | {"entropy": self.entropy}

    def _note(self, **values: float) -> None:
        for name, value in values.items():
            self._noted[name].append(float(value))

    def accepted(self, seen: np.ndarray, decisions: np.ndarray) -> np.ndarray:
        """Which trials to run, shape (n,), at random: those of near-certain success with the
        probability `acceptance`, uncertain ones always.
        """
        if self.updates == 0:
            return np.ones(len(seen), dtype=bool)
        worth = (1.0 - self.predicted(seen, decisions)) / (1.0 - SURE)
        chosen = self._rng.random(len(seen)) < np.maximum(worth, self._recipe.acceptance)
        self._note(acceptance=chosen.mean())
        return chosen

    def learn(self, share: float) -> None:
        """Make the updates due for the trials so far, once there are enough; `share` of the
        training has passed.

        Raises:
            RunError: The networks' outputs are no longer finite.
        """
        recipe = self._recipe
        trials = self.trials
        if trials.count < recipe.random_episodes:
            return
        if self.updates == 0:
            unseen = [TYPE] if recipe.env_id == GRASP_TYPE else []
            self.networks.fit_scales(
                trials.seen[: trials.count], trials.end_state[: trials.count], unseen
            )
        for name in ("critics", "actor"):
            self.networks.optimizers[name].param_groups[0]["lr"] = recipe.learning_rate * max(
                0.05, 1.0 - share
            )
        target_entropy = trials.decisions.shape[1] * (
            recipe.target_entropy_first
            + (recipe.target_entropy_last - recipe.target_entropy_first) * share
        )
        while self.updates < trials.count * recipe.updates_per_episode:
            self._update(target_entropy)
            self.updates += 1
            if not np.isfinite(self.entropy):
                raise RunError(
                    f"the training diverged before trial {trials.count}: its last checkpoint is kept; a lower "
                    f"learning_rate than {recipe.learning_rate:g} may help"
                )

    def _update(self, target_entropy: float) -> None:
        recipe = self._recipe
        trials = self.trials
        rows = self._rng.integers(trials.count, size=(recipe.critics, recipe.batch_size))
        seen = self.networks.scaled(trials.seen[rows])
        survived = torch.from_numpy(trials.survived[rows])[:, :, None]
        predicted = self.networks.critics(
            torch.cat([seen, torch.from_numpy(trials.decisions[rows])], -1), fitting=True
        )
        odds, end_state = predicted.split([len(self._phases), trials.end_state.shape[1]], -1)
        through = (survived > self._phases).float()
        reached = (survived >= self._phases).float()
        losses = reached * functional.binary_cross_entropy_with_logits(
            odds, through, reduction="none"
        )
        truth = torch.from_numpy(
            scaled(
                trials.end_state[rows], self.networks.mean_end_state, self.networks.scale_end_state
            )
        )
        optimizers = self.networks.optimizers
        survival_loss = losses.sum(-1).mean()
        auxiliary_loss = functional.mse_loss(end_state, truth)
        descend(optimizers["critics"], survival_loss + recipe.auxiliary_coef * auxiliary_loss)
        self._note(survival_loss=survival_loss.item(), auxiliary_loss=auxiliary_loss.item())

        if recipe.script_std:
            won = np.flatnonzero(trials.survived[: trials.count] == len(self._phases))
            if not len(won):
                raise RunError(
                    f"none of the first {trials.count:,} trials held: a lower script_std than {recipe.script_std:g} may help"
                )
            rows = self._rng.choice(won, recipe.batch_size)
            seen = self.networks.scaled(trials.seen[rows])
            decisions = torch.from_numpy(trials.decisions[rows])
            log_density = self.networks.actor(seen[:, : self._deployed], decisions)[1].mean()
            self.entropy = -log_density.item() / decisions.shape[1]
            descend(optimizers["actor"], -log_density)
            self._note(actor_loss=-log_density.item())
            return

        self.networks.critics.requires_grad_(False)  # only the actor is updated by their gradient
        seen = seen[0, : recipe.actor_batch_size]
        decisions, log_density = self.networks.actor(seen[:, : self._deployed])
        success = self.networks.success(seen, decisions)
        success = success.mean(0) - recipe.pessimism * success.std(0, correction=0)
        alpha = self.networks.log_alpha.exp()
        self.entropy = -log_density.mean().item() / decisions.shape[1]
        actor_loss = (alpha.detach() * log_density - success).mean()
        descend(optimizers["actor"], actor_loss)
        self.networks.critics.requires_grad_(True)
        self._note(
            actor_loss=actor_loss.item(),
            alpha=alpha.item(),
            target_entropy=target_entropy / decisions.shape[1],
        )
        descend(optimizers["alpha"], alpha * (-log_density.mean().detach() - target_entropy))

    def arrays(self) -> dict[str, np.ndarray]:
        """State for a checkpoint by name: that of the networks, and trials if no other run has
        them.
        """
        own = {} if self._recipe.trials_of else self.trials.columns
        trials = {name: column[: self.trials.count] for name, column in own.items()}
        return self.networks.arrays() | trials

    def restore(self, arrays: dict[str, np.ndarray], updates: int) -> None:
        """Restore the state returned by `arrays`, with the trials, after a number of updates."""
        self.trials.count = 0
        self.updates = updates
        self.trials.add(*(arrays[name] for name in self.trials.columns))
        self.networks.restore(arrays)


def scripted_decisions(closures: Closures, seen: np.ndarray) -> np.ndarray:
    """Decisions for the closures of `ScriptedGraspType`, shape (n, m), on first observations of
    HPAC-GraspType-v0.
    """
    values = []
    for start in (kind.start for kind in GRASP_TYPES.values()):
        goals, preshape = map(action_from_synergy, (start.closed, start.preshape))
        values.append([*goals, CLOSE_TIME * CONTROL_HZ, 0.0, *wrist_choice(start), *preshape])
    return closures.decisions(np.array(values))[seen[:, TYPE].argmax(axis=1)]
