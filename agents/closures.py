"""Learn to grasp with one decision an episode: from the first observation to the numbers of a closure.

An episode is one trial of one closure: it gets through so many of the task's phases, and holds the object if it gets through
all. Two things are fitted to all trials so far. Critics see everything that a simulation knows, the true object with its mass
and friction too, and predict for each phase whether a closure that has come so far gets through it. They also predict what the
simulation will know at the end of the closing, such as joint angles, contact forces and the object's place, which tells
more about a trial than its outcome alone. The actor sees only what a real hand has. It draws its closures from a distribution
that it moves to where the critics predict success; how wide that stays is set by the entropy that it aims at, which falls
along the training.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from agents.errors import RunError
from agents.recipes import Recipe
from hpac_gym.envs import GraspAny, GraspAnyConfig, PickPlace, grasp_task
from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import GRASP, GRASP_ANY, PICK_PLACE, checked_options
from hpac_gym.policies import Actor, Closures
from hpac_gym.tasks.phases import Timetable
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS

SHORT = GraspAnyConfig(
    timetable=Timetable(close_time=1.6, clearance=Timetable().lift_height), side_time=1 / CONTROL_HZ, ramp_time=1 / CONTROL_HZ
)
"""HPAC-GraspAny-v0 without the time that one closure leaves unused, and without what comes once an episode is won."""
TASKS = {GRASP: grasp_task, GRASP_ANY: partial(GraspAny, config=SHORT), PICK_PLACE: PickPlace}
"""Makes the task of an id, as training plays it."""
MEAN_CLIP = 4.0
"""Bound of the actor's output before tanh."""
LOG_STD = (-4.0, 0.5)
"""Bounds of the logarithm of its spread."""
OBSERVATION_CLIP = 8.0
DRAWS = 4
"""How often an episode is drawn at most, until the learner wants to see it."""
SURE = 0.7
"""Predicted success from which a trial is not wanted for certain."""
SMALLEST_SCALE = 0.05
"""Of an observed entry; units make all entries of order one."""


@dataclass(slots=True)
class Trials:
    """Closures that were tried, one a row.

    Attributes:
        seen: the first observation of the episode, *privileged*, shape (n, k).
        decisions: the closure, −1…1, shape (n, m).
        survived: how many phases of the task it got through, shape (n,).
        came_to: what only a simulation knows at the end of the closing, or of the trial, shape (n, k − deployed).
        count: how many rows hold a trial.
    """

    seen: np.ndarray
    decisions: np.ndarray
    survived: np.ndarray
    came_to: np.ndarray
    count: int = 0

    @classmethod
    def empty(cls, size: int, observed: int, deployed: int, decided: int) -> Trials:
        """Room for so many trials."""
        seen, decisions, came_to = (np.zeros((size, width), np.float32) for width in (observed, decided, observed - deployed))
        return cls(seen, decisions, np.zeros(size, np.int64), came_to)

    def add(self, *trials: np.ndarray) -> None:
        """Append `seen`, `decisions`, `survived` and `came_to` of trials; those for which there is no room are left out."""
        rows = slice(self.count, self.count + len(trials[0]))
        room = len(self.survived[rows])
        for kept, given in zip((self.seen, self.decisions, self.survived, self.came_to), trials, strict=True):
            kept[rows] = given[:room]
        self.count += room


class Worlds:
    """n worlds of a task in which closures are tried; each begins a new episode as soon as its last one is over.

    Args:
        env_id: one of `TASKS`.
        count: n.
        closures: what a decision means.
        seed: of the first world; the others count upwards.
        options: of the environment, such as engine, body and randomize.

    Attributes:
        deployed: how many values a *deploy* observation has.
        phases: how many the task has.
        first_seen: the first observations of the episodes that run, *privileged*, shape (n, observed).
    """

    def __init__(self, env_id: str, count: int, closures: Closures, seed: int, **options: Any) -> None:
        task = TASKS[env_id]()
        self.deployed, self.phases = sum(len(term.labels) for term in task.terms), len(task.phases)
        self._close = task.phases.index("close")
        self._episodes = Episodes(task, count, checked_options(obs="privileged", **options))
        self._generators = [np.random.default_rng(seed + world) for world in range(count)]
        self._closures = closures
        self.first_seen = np.zeros((count, *self._episodes.observation_space.shape), np.float32)
        self._came_to = self.first_seen[:, self.deployed :].copy()
        self._decisions, self._steps = np.zeros((count, len(closures.names))), np.zeros(count, dtype=int)
        self._fresh = np.ones(count, dtype=bool)
        self._thread = ThreadPoolExecutor(1)

    @property
    def observed(self) -> int:
        """How many values a *privileged* observation has; the first `deployed` of them are the *deploy* ones."""
        return self.first_seen.shape[1]

    def step(self, learner: Learner, meanwhile: Callable[[], None] | None = None) -> tuple[np.ndarray, ...]:
        """Pass one control period in all worlds.

        Args:
            learner: decides on first observations, and which of these trials it wants to see.
            meanwhile: called while another thread runs the physics, so that two cores have work.

        Returns:
            The trials that ended, as `Trials.add` takes them.
        """
        worlds = np.flatnonzero(self._fresh)
        for _ in range(DRAWS):
            if not len(worlds):
                break
            self._episodes.reset(worlds.tolist(), [self._generators[world] for world in worlds])
            self.first_seen[worlds], self._steps[worlds] = self._episodes.observe()[worlds], 0
            self._decisions[worlds] = learner.decide(self.first_seen[worlds])
            worlds = worlds[~learner.wanted(self.first_seen[worlds], self._decisions[worlds])]
        phase = self._episodes.now.phase.copy()
        actions = self._closures.actions(self._decisions, self._steps).astype(np.float32)
        physics = self._thread.submit(self._episodes.step, actions)
        if meanwhile:
            meanwhile()
        physics.result()
        self._steps += 1
        closing = phase <= self._close
        self._came_to[closing] = self._episodes.observe()[closing, self.deployed :]
        self._fresh = self._episodes.outcome != RUNNING
        ended = np.flatnonzero(self._fresh)
        held = self._episodes.outcome[ended] == SUCCESS
        survived = np.where(held, self.phases, phase[ended])
        return self.first_seen[ended], self._decisions[ended], survived, self._came_to[ended]

    def close(self) -> None:
        """Free the physics. Closing twice is no error."""
        self._thread.shutdown()
        self._episodes.close()


def worlds_of(recipe: Recipe, seed: int) -> list[Worlds]:
    """The worlds of a recipe, in equal parts for each of its bodies, with seeds from `seed` upwards."""
    count, bodies = recipe.num_envs, recipe.body
    shares = [count * (place + 1) // len(bodies) - count * place // len(bodies) for place in range(len(bodies))]
    options = {"engine": recipe.engine, "randomize": recipe.randomize}
    made = []
    for body, share in zip(bodies, shares, strict=True):
        made.append(Worlds(recipe.env_id, share, recipe.closures, seed, body=body, **options))
        seed += share
    return made


class Critics(nn.Module):
    """Several networks that predict the log-odds of getting through each phase, all in one product of matrices.

    Args:
        count: how many.
        sizes: of the layers, with those of the input and of the output.
        dropout: share of the hidden values that a fit leaves out.
    """

    def __init__(self, count: int, sizes: Sequence[int], dropout: float) -> None:
        super().__init__()
        pairs = list(pairwise(sizes))
        last = len(pairs) - 1
        scales = [(2 / a) ** 0.5 * (0.1 if place == last else 1.0) for place, (a, _) in enumerate(pairs)]
        self.weights = nn.ParameterList(scale * torch.randn(count, *pair) for scale, pair in zip(scales, pairs, strict=True))
        self.biases = nn.ParameterList(torch.zeros(count, 1, b) for _, b in pairs)
        self._dropout = dropout

    def forward(self, values: Tensor, fitting: bool = False) -> Tensor:
        """Log-odds, shape (count, n, phases), of values, shape (n, k), the same for all, or (count, n, k)."""
        if values.dim() == 2:
            values = values.expand(len(self.weights[0]), -1, -1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            values = functional.dropout(functional.silu(torch.baddbmm(bias, values, weight)), self._dropout, fitting)
        return torch.baddbmm(self.biases[-1], values, self.weights[-1])


class Spread(nn.Module):
    """The actor: a normal distribution under tanh, of the numbers of a closure.

    Args:
        observed: how many values it sees.
        hidden: widths of its layers.
        decided: how many numbers it gives.
    """

    def __init__(self, observed: int, hidden: Sequence[int], decided: int) -> None:
        super().__init__()
        widths = [observed, *hidden]
        layers = [part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU())]
        self.body = nn.Sequential(*layers)
        self.mean, self.log_std = nn.Linear(widths[-1], decided), nn.Linear(widths[-1], decided)
        with torch.no_grad():
            for head in (self.mean, self.log_std):
                head.weight *= 0.1

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """A drawn decision, shape (n, m), and the logarithm of its density, shape (n,)."""
        value = self.body(seen)
        mean, log_std = self.mean(value).clamp(-MEAN_CLIP, MEAN_CLIP), self.log_std(value).clamp(*LOG_STD)
        noise = torch.randn_like(mean)
        raw = mean + log_std.exp() * noise
        # log(1 − tanh²) of a large number is lost to rounding; this form of it is not.
        squash = 2 * (np.log(2) - raw - functional.softplus(-2 * raw))
        return torch.tanh(raw), (-0.5 * noise**2 - log_std - 0.5 * np.log(2 * np.pi) - squash).sum(-1)


class Learner:
    """Critics, an actor, and the trials that they are fitted to.

    Args:
        recipe: the settings.
        observed: how many values a *privileged* observation has.
        deployed: how many of them, the first ones, the actor sees.
        phases: how many the task has.
    """

    def __init__(self, recipe: Recipe, observed: int, deployed: int, phases: int) -> None:
        self._recipe, self._deployed, self._phases = recipe, deployed, torch.arange(phases)
        decided = len(recipe.closures.names)
        torch.manual_seed(recipe.seed)
        self._rng = np.random.default_rng(recipe.seed)
        self.trials = Trials.empty(recipe.episodes, observed, deployed, decided)
        self.mean, self.scale = np.zeros(observed, np.float32), np.ones(observed, np.float32)
        self.mean_came_to, self.scale_came_to = self.mean[deployed:], self.scale[deployed:]
        predicted = phases + observed - deployed
        self.critics = Critics(recipe.critics, [observed + decided, *recipe.hidden, predicted], recipe.dropout)
        self.actor = Spread(deployed, recipe.hidden, decided)
        self.log_weight = torch.tensor(-3.0, requires_grad=True)
        fused = {"fused": True}
        self.optimizers = {
            "critics": torch.optim.AdamW(self.critics.parameters(), weight_decay=recipe.weight_decay, **fused),
            "actor": torch.optim.Adam(self.actor.parameters(), **fused),
            "weight": torch.optim.Adam([self.log_weight], lr=1e-2),
        }
        self.updates, self.entropy = 0, float("nan")

    def reseed(self, seed: int) -> None:
        """Draw what comes from other numbers, as a resumed training has to."""
        torch.manual_seed(seed)
        self._rng = np.random.default_rng(seed)

    def decide(self, seen: np.ndarray) -> np.ndarray:
        """Decisions to try, shape (n, m), for first observations, shape (n, observed): random ones before anything is fitted."""
        if self.updates == 0:
            return self._rng.uniform(-1.0, 1.0, (len(seen), self.trials.decisions.shape[1]))
        with torch.no_grad():
            return self.actor(self._scaled(seen)[:, : self._deployed])[0].numpy().astype(float)

    def predicted(self, seen: np.ndarray, decisions: np.ndarray) -> np.ndarray:
        """Probability that trials succeed, shape (n,), as the critics see it."""
        with torch.no_grad():
            success = self._success(self._scaled(seen), torch.from_numpy(decisions.astype(np.float32)))
        return success.mean(0).exp().numpy()

    def wanted(self, seen: np.ndarray, decisions: np.ndarray) -> np.ndarray:
        """Whether trials are worth their time, shape (n,), drawn: of those that the critics are sure of, a part is enough."""
        if self.updates == 0:
            return np.ones(len(seen), dtype=bool)
        worth = (1.0 - self.predicted(seen, decisions)) / (1.0 - SURE)
        return self._rng.random(len(seen)) < np.maximum(worth, self._recipe.easy_share)

    def learn(self, share: float) -> None:
        """Make the updates that the trials so far are worth, once there are enough; `share` of the training has passed.

        Raises:
            RunError: The networks no longer give numbers.
        """
        recipe, trials = self._recipe, self.trials
        if trials.count < recipe.random_episodes:
            return
        if self.updates == 0:
            self.mean, self.scale = np.float32(mean_and_scale(trials.seen[: trials.count]))
            self.mean_came_to, self.scale_came_to = np.float32(mean_and_scale(trials.came_to[: trials.count]))
        for name in ("critics", "actor"):
            for group in self.optimizers[name].param_groups:
                group["lr"] = recipe.learning_rate * max(0.05, 1.0 - share)
        aim = trials.decisions.shape[1] * (recipe.entropy_first + (recipe.entropy_last - recipe.entropy_first) * share)
        while self.updates < trials.count * recipe.updates_per_episode:
            self._update(aim)
            self.updates += 1
            if not np.isfinite(self.entropy):
                raise RunError(f"the training diverged before trial {trials.count}: its last checkpoint is kept; a lower "
                               f"learning_rate than {recipe.learning_rate:g} may help")  # fmt: skip

    def _update(self, aim: float) -> None:
        recipe, trials = self._recipe, self.trials
        rows = self._rng.integers(trials.count, size=(recipe.critics, recipe.batch_size))
        seen, survived = self._scaled(trials.seen[rows]), torch.from_numpy(trials.survived[rows])[:, :, None]
        predicted = self.critics(torch.cat([seen, torch.from_numpy(trials.decisions[rows])], -1), fitting=True)
        odds, came_to = predicted.split([len(self._phases), trials.came_to.shape[1]], -1)
        through, reached = (survived > self._phases).float(), (survived >= self._phases).float()
        losses = reached * functional.binary_cross_entropy_with_logits(odds, through, reduction="none")
        truth = torch.from_numpy(scaled(trials.came_to[rows], self.mean_came_to, self.scale_came_to))
        self._descend("critics", losses.sum(-1).mean() + recipe.aftermath * functional.mse_loss(came_to, truth))

        self.critics.requires_grad_(False)  # the actor moves along their slope; they themselves stay
        seen = seen[0, : recipe.actor_batch_size]
        decisions, log_density = self.actor(seen[:, : self._deployed])
        success = self._success(seen, decisions)
        success = success.mean(0) - recipe.doubt * success.std(0, correction=0)  # what they disagree on is not believed
        weight = self.log_weight.exp()
        self.entropy = -log_density.mean().item() / decisions.shape[1]
        self._descend("actor", (weight.detach() * log_density - success).mean())
        self.critics.requires_grad_(True)
        self._descend("weight", weight * (-log_density.mean().detach() - aim))

    def _success(self, scaled: Tensor, decisions: Tensor) -> Tensor:
        """Logarithm of the probability of getting through all phases, by each critic, shape (critics, n)."""
        odds = self.critics(torch.cat([scaled, decisions], -1))[..., : len(self._phases)]
        return functional.logsigmoid(odds).sum(-1)

    def _descend(self, name: str, loss: Tensor) -> None:
        optimizer = self.optimizers[name]
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    def _scaled(self, seen: np.ndarray) -> Tensor:
        return torch.from_numpy(scaled(seen, self.mean, self.scale))

    def weights(self) -> dict[str, Any]:
        """What PyTorch saves and `load_weights` takes: networks, optimisers and the weight of the entropy."""
        saved = {"critics": self.critics.state_dict(), "actor": self.actor.state_dict(), "log_weight": self.log_weight.detach()}
        return saved | {f"of {name}": optimizer.state_dict() for name, optimizer in self.optimizers.items()}

    def load_weights(self, saved: dict[str, Any]) -> None:
        """Take over what `weights` gave."""
        self.critics.load_state_dict(saved["critics"])
        self.actor.load_state_dict(saved["actor"])
        for name, optimizer in self.optimizers.items():
            optimizer.load_state_dict(saved["of " + name])
        with torch.no_grad():
            self.log_weight.copy_(saved["log_weight"])

    def policy(self) -> Actor:
        """The actor without its spread, as plain arrays with the scaling of its observations."""
        layers = [layer for layer in (*self.actor.body, self.actor.mean) if isinstance(layer, nn.Linear)]
        return Actor(
            observation_mean=self.mean[: self._deployed].astype(float),
            observation_scale=self.scale[: self._deployed].astype(float),
            observation_clip=OBSERVATION_CLIP,
            layers=tuple((layer.weight.detach().numpy().copy(), layer.bias.detach().numpy().copy()) for layer in layers),
            mean_clip=MEAN_CLIP,
        )


def mean_and_scale(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each column; one that hardly varies, such as the noise of an angle, is not blown up."""
    values = values.astype(float)
    return values.mean(axis=0), np.maximum(values.std(axis=0), SMALLEST_SCALE)


def scaled(values: np.ndarray, mean: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Values as a network takes them, as `Actor` computes them."""
    return np.clip((values - mean) / scale, -OBSERVATION_CLIP, OBSERVATION_CLIP)
