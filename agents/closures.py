"""Learn to grasp with one decision per episode: from the first observation to the numbers of a
closure.

An episode is one trial of one closure: it survives some of the task's phases, and succeeds if it
survives all. Two kinds of network are fitted to all trials so far. The critics observe the full
simulation state and predict for each phase whether a closure that reached it survives it, and the
simulation state at the end of the closing. The actor observes only what a real hand has. It samples
closures from a distribution that it shifts towards predicted success, at a target entropy that
falls during the training. `docs/learning.md` has the reasons.

Where random closures hardly ever succeed, the first trials are drawn about the task's script, and
the actor maximises the likelihood of the trials that succeeded instead; the critics then only
choose the episodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from agents import RunError
from agents.recipes import Recipe
from hpac_gym.envs import GraspAny, GraspAnyConfig, GraspByType, make_task
from hpac_gym.envs.episodes import Episodes
from hpac_gym.envs.options import checked_options
from hpac_gym.model import action_from_synergy
from hpac_gym.policies import Actor, Closures
from hpac_gym.registration import GRASP_ANY, GRASP_TYPE
from hpac_gym.tasks.grasp_types import GRASP_TYPES, wrist_choice
from hpac_gym.tasks.phases import Timetable
from hpac_gym.tasks.scripted import CLOSE_TIME
from hpac_gym.tasks.task import CONTROL_HZ, RUNNING, SUCCESS, Task
from hpac_gym.tasks.terms import Layout

SHORT = GraspAnyConfig(
    timetable=Timetable(close_time=1.6, clearance=Timetable().lift_height),
    side_time=1 / CONTROL_HZ,
    ramp_time=1 / CONTROL_HZ,
)
"""HPAC-GraspAny-v1 without the time that a single closure does not use, and without the phases
after success.
"""
TYPE = Layout(GraspByType().terms, 1).slices["type"]
"""Entries of an observation of HPAC-GraspType-v0 with the type's name. The networks do not see
them: the rest of the observation contains the type's rule, which also describes unseen types."""
MEAN_CLIP = 4.0  # bound of the actor's output before tanh
LOG_STD = (-4.0, 0.5)  # bounds of the logarithm of the actor's standard deviation, before tanh
OBSERVATION_CLIP = 8.0
DRAWS = 4  # maximal number of draws of an episode until the learner accepts it
WEAK = (0.5, 1.0)
"""Factors of the skin's friction in weak contacts (`docs/physics.md`: PyBullet's contacts hold half
of the friction cone).
"""
SURE = 0.7  # predicted success above which a trial may be rejected
# Largest number below 1 in single precision: a tanh may round to 1, which has no density.
BELOW_ONE = 1.0 - 2.0**-24
MOST = 0.98  # bound of the first decisions about a script, where the actor's tanh can imitate them
UNSEEN = 1e9  # scale of an entry that the networks do not see
SCALES = ("mean", "scale", "mean_came_to", "scale_came_to")
# lower bound of the scale of an observation entry; in their units, entries are of order one
SMALLEST_SCALE = 0.05


class Trials:
    """Trials of closures, one per row: a table with room for `size` of them, of which `count` are
    in use.

    Attributes:
        seen: first observation of the episode, *privileged*, shape (size, observed).
        decisions: decision for a closure, −1…1, shape (size, decided).
        survived: number of phases that the closure survived, shape (size,).
        came_to: privileged entries at the end of the closing, or of the trial if earlier, shape
            (size, observed − deployed).
        columns: these arrays by name.
    """

    def __init__(self, size: int, observed: int, deployed: int, decided: int) -> None:
        self.seen = np.zeros((size, observed), np.float32)
        self.decisions = np.zeros((size, decided), np.float32)
        self.survived = np.zeros(size, np.int64)
        self.came_to = np.zeros((size, observed - deployed), np.float32)
        self.columns = dict(vars(self))
        self.count = 0

    def add(self, *trials: np.ndarray) -> None:
        """Append the `columns` of trials; those beyond the room of the table are dropped."""
        rows = slice(self.count, self.count + len(trials[0]))
        room = len(self.survived[rows])
        for kept, given in zip(self.columns.values(), trials, strict=True):
            kept[rows] = given[:room]
        self.count += room


class Worlds:
    """n worlds in which closures are tried; each starts a new episode as soon as its last one has
    ended.

    The set-ups of a recipe share its worlds equally; these are the worlds of the set-up at index
    `place`. With several set-ups, the critics are told by one number each which of them a trial
    had, and the actor is not.

    Attributes:
        observed: size of a first observation: *privileged*, and the numbers of the set-ups.
        deployed: number of its first entries, the *deploy* observation.
        phases: number of phases of the task.
        first_seen: first observations of the running episodes, shape (n, observed).
        steps: control steps of all its worlds in a call of `step`.
    """

    def __init__(self, task: Task, recipe: Recipe, place: int) -> None:
        set_ups = len(recipe.set_ups)
        self._first, end = (recipe.num_envs * bound // set_ups for bound in (place, place + 1))
        engine, body = recipe.set_ups[place].split("/")
        options = checked_options(
            obs="privileged", engine=engine, body=body, randomize=recipe.randomize
        )
        if (
            recipe.contacts == "weak"
        ):  # no torsional friction, and less of the skin's, drawn for each episode
            low, high = options.randomize.skin_friction
            randomize = replace(options.randomize, skin_friction=(WEAK[0] * low, WEAK[1] * high))
            options = replace(
                options, randomize=randomize, world=replace(options.world, torsion=0.0)
            )
        count = self.steps = end - self._first
        self.episodes = Episodes(task, count, options)
        self._told = np.tile(
            np.eye(set_ups, dtype=np.float32)[place, : set_ups if set_ups > 1 else 0], (count, 1)
        )
        self.deployed = sum(len(term.labels) for term in task.terms)
        self.phases = len(task.phases)
        self.observed = self.episodes.observations.space.shape[0] + self._told.shape[1]
        self.first_seen = np.zeros((count, self.observed), np.float32)
        self._came_to = self.first_seen[:, self.deployed :].copy()
        self._close = task.phases.index("close") if "close" in task.phases else self.phases
        self._closures = recipe.closures
        self._decisions = np.zeros((count, len(self._closures.names)))
        self._steps = np.zeros(count, dtype=int)
        self._thread = ThreadPoolExecutor(1)

    def start(self, seed: int) -> None:
        """Drop the running episodes and begin others; `seed` is that of the recipe's first world,
        the others count upwards.
        """
        self._generators = [
            np.random.default_rng(seed + self._first + world) for world in range(self.steps)
        ]
        self._fresh = np.ones(self.steps, dtype=bool)

    def step(
        self, learner: Learner, meanwhile: Callable[[], None] = lambda: None
    ) -> tuple[np.ndarray, ...]:
        """Advance all worlds by one control period.

        Args:
            learner: makes the decisions and selects the trials to run.
            meanwhile: called while another thread runs the physics, to use two cores.

        Returns:
            The trials that ended, as arguments of `Trials.add`.
        """
        worlds = np.flatnonzero(self._fresh)
        for _ in range(DRAWS):
            if not len(worlds):
                break
            self.episodes.reset(worlds.tolist(), [self._generators[world] for world in worlds])
            self.first_seen[worlds] = self._seen()[worlds]
            self._steps[worlds] = 0
            self._decisions[worlds] = learner.decide(self.first_seen[worlds])
            worlds = worlds[~learner.wanted(self.first_seen[worlds], self._decisions[worlds])]
        phase = self.episodes.now.phase.copy()
        actions = self._closures.actions(self._decisions, self._steps).astype(np.float32)
        physics = self._thread.submit(self.episodes.step, actions)
        meanwhile()
        physics.result()
        self._steps += 1
        closing = phase <= self._close
        self._came_to[closing] = self._seen()[closing, self.deployed :]
        self._fresh = self.episodes.outcome != RUNNING
        ended = np.flatnonzero(self._fresh)
        held = self.episodes.outcome[ended] == SUCCESS
        survived = np.where(held, self.phases, phase[ended])
        return self.first_seen[ended], self._decisions[ended], survived, self._came_to[ended]

    def _seen(self) -> np.ndarray:
        return np.hstack([self.episodes.observe(), self._told])

    def close(self) -> None:
        """Free the physics; may be called repeatedly."""
        self._thread.shutdown()
        self.episodes.close()


def training_task(recipe: Recipe) -> Task:
    """A new task of a recipe."""
    if recipe.env_id == GRASP_ANY:
        return GraspAny(hands=recipe.hands, config=replace(SHORT, size=recipe.sizes or SHORT.size))
    if recipe.env_id == GRASP_TYPE:
        return GraspByType(types="train")
    return make_task(recipe.env_id)


def worlds_of(recipe: Recipe, make: Callable[[Recipe], Task] = training_task) -> list[Worlds]:
    """The worlds of each set-up of a recipe, each with a task that `make` makes; they need a
    `Worlds.start`.
    """
    return [Worlds(make(recipe), recipe, place) for place in range(len(recipe.set_ups))]


def sizes_of(recipe: Recipe) -> tuple[int, int, int]:
    """Numbers `observed`, `deployed` and `phases` of the worlds of a recipe, which need not
    exist.
    """
    samples = worlds_of(replace(recipe, num_envs=len(recipe.set_ups)))
    for sample in samples:
        sample.close()
    return samples[0].observed, samples[0].deployed, samples[0].phases


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


class Spread(nn.Module):
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
        self.mean_came_to = self.mean[deployed:]
        self.scale_came_to = self.scale[deployed:]
        sizes = [observed + decided, *recipe.hidden, phases + observed - deployed]
        self.critics = Critics(recipe.critics, sizes, recipe.dropout)
        self.actor = Spread(deployed, recipe.hidden, decided)
        self.log_weight = torch.tensor(-3.0, requires_grad=True)
        self.optimizers = {
            "critics": torch.optim.AdamW(
                self.critics.parameters(), weight_decay=recipe.weight_decay, fused=True
            ),
            "actor": torch.optim.Adam(self.actor.parameters(), fused=True),
            "weight": torch.optim.Adam([self.log_weight], lr=1e-2),
        }
        self.updates = 0
        self.entropy = float("nan")

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
        if not self._recipe.spread:
            return self._rng.uniform(-1.0, 1.0, (len(seen), self.trials.decisions.shape[1]))
        widths = self._recipe.spread * 10.0 ** self._rng.uniform(-1, 0, (len(seen), 1))
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

    def wanted(self, seen: np.ndarray, decisions: np.ndarray) -> np.ndarray:
        """Which trials to run, shape (n,), at random: only part of those whose predicted success is
        high.
        """
        if self.updates == 0:
            return np.ones(len(seen), dtype=bool)
        worth = (1.0 - self.predicted(seen, decisions)) / (1.0 - SURE)
        return self._rng.random(len(seen)) < np.maximum(worth, self._recipe.easy_share)

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
            self.mean_came_to, self.scale_came_to = np.float32(
                mean_and_scale(trials.came_to[: trials.count])
            )
            if recipe.env_id == GRASP_TYPE:
                self.scale[TYPE] = UNSEEN
            if recipe.critic_obs == "deploy":
                self.scale[self._deployed :] = UNSEEN
        for name in ("critics", "actor"):
            self.optimizers[name].param_groups[0]["lr"] = recipe.learning_rate * max(
                0.05, 1.0 - share
            )
        aim = trials.decisions.shape[1] * (
            recipe.entropy_first + (recipe.entropy_last - recipe.entropy_first) * share
        )
        while self.updates < trials.count * recipe.updates_per_episode:
            self._update(aim)
            self.updates += 1
            if not np.isfinite(self.entropy):
                raise RunError(
                    f"the training diverged before trial {trials.count}: its last checkpoint is kept; a lower "
                    f"learning_rate than {recipe.learning_rate:g} may help"
                )

    def _update(self, aim: float) -> None:
        recipe = self._recipe
        trials = self.trials
        rows = self._rng.integers(trials.count, size=(recipe.critics, recipe.batch_size))
        seen = self._scaled(trials.seen[rows])
        survived = torch.from_numpy(trials.survived[rows])[:, :, None]
        predicted = self.critics(
            torch.cat([seen, torch.from_numpy(trials.decisions[rows])], -1), fitting=True
        )
        odds, came_to = predicted.split([len(self._phases), trials.came_to.shape[1]], -1)
        through = (survived > self._phases).float()
        reached = (survived >= self._phases).float()
        losses = reached * functional.binary_cross_entropy_with_logits(
            odds, through, reduction="none"
        )
        truth = torch.from_numpy(
            scaled(trials.came_to[rows], self.mean_came_to, self.scale_came_to)
        )
        self._descend(
            "critics",
            losses.sum(-1).mean() + recipe.aftermath * functional.mse_loss(came_to, truth),
        )

        if recipe.spread:
            won = np.flatnonzero(trials.survived[: trials.count] == len(self._phases))
            if not len(won):
                raise RunError(
                    f"none of the first {trials.count:,} trials held: a lower spread than {recipe.spread:g} may help"
                )
            rows = self._rng.choice(won, recipe.batch_size)
            seen = self._scaled(trials.seen[rows])
            decisions = torch.from_numpy(trials.decisions[rows])
            log_density = self.actor(seen[:, : self._deployed], decisions)[1].mean()
            self.entropy = -log_density.item() / decisions.shape[1]
            self._descend("actor", -log_density)
            return

        self.critics.requires_grad_(False)  # only the actor is updated by their gradient
        seen = seen[0, : recipe.actor_batch_size]
        decisions, log_density = self.actor(seen[:, : self._deployed])
        success = self._success(seen, decisions)
        # Pessimistic where the critics disagree.
        success = success.mean(0) - recipe.doubt * success.std(0, correction=0)
        weight = self.log_weight.exp()
        self.entropy = -log_density.mean().item() / decisions.shape[1]
        self._descend("actor", (weight.detach() * log_density - success).mean())
        self.critics.requires_grad_(True)
        self._descend("weight", weight * (-log_density.mean().detach() - aim))

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
        """State for a checkpoint by name: scaling, networks, optimisers, entropy weight, and trials
        if no other run has them.
        """
        tensors = {"log_weight": self.log_weight.detach()}
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
        self.log_weight.data.copy_(torch.from_numpy(arrays["log_weight"]))

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
