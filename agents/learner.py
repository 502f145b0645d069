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

from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from agents import RunError
from agents.recipes import Recipe
from agents.trials import Trials
from hpac_gym.model import action_from_synergy
from hpac_gym.policies import Actor, Closures
from hpac_gym.registration import GRASP_TYPE
from hpac_gym.tasks.grasp_types import GRASP_TYPES, GraspByType, wrist_choice
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ
from hpac_gym.tasks.terms import Layout

TYPE = Layout(GraspByType().terms, 1).slices["type"]
"""Entries of an observation of HPAC-GraspType-v0 with the type's name. The networks do not see
them: the rest of the observation contains the type's rule, which also describes unseen types."""
MEAN_CLIP = 4.0  # bound of the actor's output before tanh
LOG_STD = (-4.0, 0.5)  # bounds of the logarithm of the actor's standard deviation, before tanh
OBSERVATION_CLIP = 8.0
SURE = 0.7  # predicted success above which a trial may be rejected
# Largest number below 1 in single precision: a tanh may round to 1, which has no density.
BELOW_ONE = 1.0 - 2.0**-24
MOST = 0.98  # bound of the first decisions about a script, where the actor's tanh can imitate them
UNSEEN = 1e9  # scale of an entry that the networks do not see
SCALES = ("mean", "scale", "mean_end_state", "scale_end_state")
# lower bound of the scale of an observation entry; in their units, entries are of order one
SMALLEST_SCALE = 0.05


class Critics(nn.Module):
    """`count` networks with layers of `sizes`, including input and output, evaluated as batched
    matrix products.
    """

    def __init__(self, count: int, sizes: Sequence[int], dropout: float) -> None:
        super().__init__()
        pairs = list(pairwise(sizes))
        last = len(pairs) - 1
        scales = [
            (2 / a) ** 0.5 * (0.1 if place == last else 1.0) for place, (a, _) in enumerate(pairs)
        ]
        self.weights = nn.ParameterList(
            scale * torch.randn(count, *pair) for scale, pair in zip(scales, pairs, strict=True)
        )
        self.biases = nn.ParameterList(torch.zeros(count, 1, b) for _, b in pairs)
        self._dropout = dropout

    def forward(self, values: Tensor, fitting: bool = False) -> Tensor:
        """Log-odds, shape (count, n, phases), of values, shape (n, k), the same for all, or (count,
        n, k).
        """
        if values.dim() == 2:
            values = values.expand(len(self.weights[0]), -1, -1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = functional.dropout(
                functional.silu(torch.baddbmm(bias, values, weight)), self._dropout, fitting
            )
        return torch.baddbmm(self.biases[-1], values, self.weights[-1])


class GaussianActor(nn.Module):
    """The actor: a tanh-squashed normal distribution of the `decided` numbers of a closure, from
    `observed` inputs.
    """

    def __init__(self, observed: int, hidden: Sequence[int], decided: int) -> None:
        super().__init__()
        widths = [observed, *hidden]
        self.body = nn.Sequential(
            *(part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU()))
        )
        self.mean = nn.Linear(widths[-1], decided)
        self.log_std = nn.Linear(widths[-1], decided)
        with torch.no_grad():
            for head in (self.mean, self.log_std):
                head.weight *= 0.1

    def forward(self, seen: Tensor, decisions: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Decisions, shape (n, m), sampled unless they are given, and their log-density, shape
        (n,).
        """
        value = self.body(seen)
        mean = self.mean(value).clamp(-MEAN_CLIP, MEAN_CLIP)
        log_std = self.log_std(value).clamp(*LOG_STD)
        if decisions is None:
            noise = torch.randn_like(mean)
        else:
            noise = (torch.atanh(decisions.clamp(-BELOW_ONE, BELOW_ONE)) - mean) / log_std.exp()
        raw = mean + log_std.exp() * noise
        # A numerically stable form of log(1 − tanh²) for large arguments.
        squash = 2 * (np.log(2) - raw - functional.softplus(-2 * raw))
        return torch.tanh(raw), (-0.5 * noise**2 - log_std - 0.5 * np.log(2 * np.pi) - squash).sum(
            -1
        )


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
        self.mean = np.zeros(observed, np.float32)
        self.scale = np.ones(observed, np.float32)
        self.mean_end_state = self.mean[deployed:]
        self.scale_end_state = self.scale[deployed:]
        sizes = [observed + decided, *recipe.hidden, phases + observed - deployed]
        self.critics = Critics(recipe.critics, sizes, recipe.dropout)
        self.actor = GaussianActor(deployed, recipe.hidden, decided)
        self.log_alpha = torch.tensor(-3.0, requires_grad=True)
        self.optimizers = {
            "critics": torch.optim.AdamW(
                self.critics.parameters(), weight_decay=recipe.weight_decay, fused=True
            ),
            "actor": torch.optim.Adam(self.actor.parameters(), fused=True),
            "alpha": torch.optim.Adam([self.log_alpha], lr=1e-2),
        }
        self.updates = 0
        self.entropy = float("nan")
        self._sums: Counter[str] = Counter()
        self._counts: Counter[str] = Counter()

    def reseed(self, seed: int) -> None:
        """Seed all random numbers."""
        torch.manual_seed(seed)
        self._rng = np.random.default_rng(seed)

    def decide(self, seen: np.ndarray) -> np.ndarray:
        """Decisions to try, shape (n, m), for first observations, shape (n, observed); random
        before the first update.
        """
        if self.updates:
            with torch.no_grad():
                return self.actor(self._scaled(seen)[:, : self._deployed])[0].numpy().astype(float)
        if not self._recipe.script_std:
            return self._rng.uniform(-1.0, 1.0, (len(seen), self.trials.decisions.shape[1]))
        widths = self._recipe.script_std * 10.0 ** self._rng.uniform(-1, 0, (len(seen), 1))
        drawn = scripted_decisions(self._recipe.closures, seen)
        return np.clip(drawn + widths * self._rng.standard_normal(drawn.shape), -MOST, MOST)

    def predicted(self, seen: np.ndarray, decisions: np.ndarray) -> np.ndarray:
        """Success probability of trials predicted by the critics, shape (n,)."""
        with torch.no_grad():
            return (
                self._success(self._scaled(seen), torch.from_numpy(decisions.astype(np.float32)))
                .mean(0)
                .exp()
                .numpy()
            )

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
        means = {name: total / self._counts[name] for name, total in self._sums.items()}
        self._sums.clear()
        self._counts.clear()
        return means | {"entropy": self.entropy}

    def _note(self, **values: float) -> None:
        self._sums.update({name: float(value) for name, value in values.items()})
        self._counts.update(values.keys())

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
            self.mean, self.scale = np.float32(mean_and_scale(trials.seen[: trials.count]))
            self.mean_end_state, self.scale_end_state = np.float32(
                mean_and_scale(trials.end_state[: trials.count])
            )
            if recipe.env_id == GRASP_TYPE:
                self.scale[TYPE] = UNSEEN
            if recipe.critic_obs == "deploy":
                self.scale[self._deployed :] = UNSEEN
        for name in ("critics", "actor"):
            self.optimizers[name].param_groups[0]["lr"] = recipe.learning_rate * max(
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
        seen = self._scaled(trials.seen[rows])
        survived = torch.from_numpy(trials.survived[rows])[:, :, None]
        predicted = self.critics(
            torch.cat([seen, torch.from_numpy(trials.decisions[rows])], -1), fitting=True
        )
        odds, end_state = predicted.split([len(self._phases), trials.end_state.shape[1]], -1)
        through = (survived > self._phases).float()
        reached = (survived >= self._phases).float()
        losses = reached * functional.binary_cross_entropy_with_logits(
            odds, through, reduction="none"
        )
        truth = torch.from_numpy(
            scaled(trials.end_state[rows], self.mean_end_state, self.scale_end_state)
        )
        survival_loss = losses.sum(-1).mean()
        auxiliary_loss = functional.mse_loss(end_state, truth)
        self._descend("critics", survival_loss + recipe.auxiliary_coef * auxiliary_loss)
        self._note(survival_loss=survival_loss.item(), auxiliary_loss=auxiliary_loss.item())

        if recipe.script_std:
            won = np.flatnonzero(trials.survived[: trials.count] == len(self._phases))
            if not len(won):
                raise RunError(
                    f"none of the first {trials.count:,} trials held: a lower script_std than {recipe.script_std:g} may help"
                )
            rows = self._rng.choice(won, recipe.batch_size)
            seen = self._scaled(trials.seen[rows])
            decisions = torch.from_numpy(trials.decisions[rows])
            log_density = self.actor(seen[:, : self._deployed], decisions)[1].mean()
            self.entropy = -log_density.item() / decisions.shape[1]
            self._descend("actor", -log_density)
            self._note(actor_loss=-log_density.item())
            return

        self.critics.requires_grad_(False)  # only the actor is updated by their gradient
        seen = seen[0, : recipe.actor_batch_size]
        decisions, log_density = self.actor(seen[:, : self._deployed])
        success = self._success(seen, decisions)
        success = success.mean(0) - recipe.pessimism * success.std(0, correction=0)
        alpha = self.log_alpha.exp()
        self.entropy = -log_density.mean().item() / decisions.shape[1]
        actor_loss = (alpha.detach() * log_density - success).mean()
        self._descend("actor", actor_loss)
        self.critics.requires_grad_(True)
        self._note(
            actor_loss=actor_loss.item(),
            alpha=alpha.item(),
            target_entropy=target_entropy / decisions.shape[1],
        )
        self._descend("alpha", alpha * (-log_density.mean().detach() - target_entropy))

    def _success(self, scaled: Tensor, decisions: Tensor) -> Tensor:
        """Log-probability of surviving all phases, by each critic, shape (critics, n)."""
        odds = self.critics(torch.cat([scaled, decisions], -1))[..., : len(self._phases)]
        return functional.logsigmoid(odds).sum(-1)

    def _descend(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def _scaled(self, seen: np.ndarray) -> Tensor:
        return torch.from_numpy(scaled(seen, self.mean, self.scale))

    def arrays(self) -> dict[str, np.ndarray]:
        """State for a checkpoint by name: scaling, networks, optimisers, alpha, and trials
        if no other run has them.
        """
        tensors = {"log_alpha": self.log_alpha.detach()}
        for name, network in (("critics", self.critics), ("actor", self.actor)):
            tensors |= {f"{name}/{key}": tensor for key, tensor in network.state_dict().items()}
        for (
            name,
            optimizer,
        ) in self.optimizers.items():  # without its settings, since the recipe has them
            for number, state in optimizer.state_dict()["state"].items():
                tensors |= {
                    f"of {name}/state/{number}/{key}": tensor for key, tensor in state.items()
                }
        scales = {name: getattr(self, name) for name in SCALES}
        own = {} if self._recipe.trials_of else self.trials.columns
        trials = {name: column[: self.trials.count] for name, column in own.items()}
        return scales | {name: tensor.numpy() for name, tensor in tensors.items()} | trials

    def restore(self, arrays: dict[str, np.ndarray], updates: int) -> None:
        """Restore the state returned by `arrays`, with the trials, after a number of updates.

        Raises:
            ValueError: There is no room for so many trials.
        """
        count = len(arrays["survived"])
        room = len(self.trials.survived)
        if count > room:
            raise ValueError(f"{count} trials, where there is room for {room}")
        self.trials.count = 0
        self.updates = updates
        self.trials.add(*(arrays[name] for name in self.trials.columns))
        for name in SCALES:
            setattr(self, name, arrays[name])
        self.log_alpha.data.copy_(torch.from_numpy(arrays["log_alpha"]))

        def tensors(place: str) -> dict[str, Tensor]:
            return {
                name.removeprefix(place): torch.from_numpy(arrays[name])
                for name in arrays
                if name.startswith(place)
            }

        self.critics.load_state_dict(tensors("critics/"))
        self.actor.load_state_dict(tensors("actor/"))
        for name, optimizer in self.optimizers.items():
            state: dict[int, dict[str, Tensor]] = {}
            for place, tensor in tensors(f"of {name}/state/").items():
                number, _, key = place.partition("/")
                state.setdefault(int(number), {})[key] = tensor
            optimizer.load_state_dict(optimizer.state_dict() | {"state": state})

    def policy(self) -> Actor:
        """The deterministic actor as plain arrays, with the scaling of its observations."""
        return actor_of(
            (*self.actor.body, self.actor.mean),
            self.mean[: self._deployed],
            self.scale[: self._deployed],
        )


def actor_of(parts: Iterable[nn.Module], mean: np.ndarray, scale: np.ndarray) -> Actor:
    """The linear layers among `parts` as plain arrays, with the scaling of their observations."""
    linear = [part for part in parts if isinstance(part, nn.Linear)]
    layers = tuple(
        (layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy())
        for layer in linear
    )
    return Actor(mean.astype(float), scale.astype(float), OBSERVATION_CLIP, layers, MEAN_CLIP)


def scripted_decisions(closures: Closures, seen: np.ndarray) -> np.ndarray:
    """Decisions for the closures of `ScriptedGraspType`, shape (n, m), on first observations of
    HPAC-GraspType-v0.
    """
    return closures.decisions(_scripted_values())[seen[:, TYPE].argmax(axis=1)]


@cache
def _scripted_values() -> np.ndarray:
    values = []
    for start in (kind.start for kind in GRASP_TYPES.values()):
        goals, preshape = map(action_from_synergy, (start.closed, start.preshape))
        values.append([*goals, CLOSE_TIME * CONTROL_HZ, 0.0, *wrist_choice(start), *preshape])
    return np.array(values)


def mean_and_scale(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each column; the latter is at least `SMALLEST_SCALE`."""
    values = values.astype(float)
    return values.mean(axis=0), np.maximum(values.std(axis=0), SMALLEST_SCALE)


def scaled(values: np.ndarray, mean: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Scale and clip values for a network, as in `Actor`."""
    return np.clip((values - mean) / scale, -OBSERVATION_CLIP, OBSERVATION_CLIP)
