"""The networks of a learner: critics, an actor, their optimisers and the scaling of observations."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from agents.recipes import Recipe
from hpac_gym.policies import Actor

MEAN_CLIP = 4.0  # bound of the actor's output before tanh
LOG_STD = (-4.0, 0.5)  # bounds of the logarithm of the actor's standard deviation, before tanh
OBSERVATION_CLIP = 8.0
# Largest number below 1 in single precision: a tanh may round to 1, which has no density.
BELOW_ONE = 1.0 - 2.0**-24
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


class Networks:
    """Critics and an actor with their optimisers, and the scaling of what they see; `observed`,
    `deployed` and `phases` are those of `Worlds`.
    """

    def __init__(self, recipe: Recipe, observed: int, deployed: int, phases: int) -> None:
        self._deployed = deployed
        self._phases = phases
        decided = len(recipe.closures.names)
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

    def fit_scales(self, seen: np.ndarray, end_state: np.ndarray, unseen: Iterable[slice]) -> None:
        """Scale observations and end states to those given; the entries `unseen` are hidden from
        the networks.
        """
        self.mean, self.scale = np.float32(mean_and_scale(seen))
        self.mean_end_state, self.scale_end_state = np.float32(mean_and_scale(end_state))
        for entries in unseen:
            self.scale[entries] = UNSEEN

    def scaled(self, seen: np.ndarray) -> Tensor:
        """Observations as the networks see them."""
        return torch.from_numpy(scaled(seen, self.mean, self.scale))

    def success(self, scaled: Tensor, decisions: Tensor) -> Tensor:
        """Log-probability of surviving all phases, by each critic, shape (critics, n)."""
        odds = self.critics(torch.cat([scaled, decisions], -1))[..., : self._phases]
        return functional.logsigmoid(odds).sum(-1)

    def arrays(self) -> dict[str, np.ndarray]:
        """Scaling, networks, optimisers and alpha by name."""
        tensors = {"log_alpha": self.log_alpha.detach()}
        for name, network in (("critics", self.critics), ("actor", self.actor)):
            tensors |= {f"{name}/{key}": tensor for key, tensor in network.state_dict().items()}
        for name, optimizer in self.optimizers.items():
            # without its settings, since the recipe has them
            for number, state in optimizer.state_dict()["state"].items():
                tensors |= {
                    f"of {name}/state/{number}/{key}": tensor for key, tensor in state.items()
                }
        scales = {name: getattr(self, name) for name in SCALES}
        return scales | {name: tensor.numpy() for name, tensor in tensors.items()}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore what `arrays` returned, or its part without the optimisers."""
        for name in SCALES:
            setattr(self, name, arrays[name])
        self.log_alpha.data.copy_(torch.tensor(arrays["log_alpha"]))

        def tensors(place: str) -> dict[str, Tensor]:
            return {
                name.removeprefix(place): torch.tensor(arrays[name])
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


def descend(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """One step of an optimiser down the gradient of a loss."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


def actor_of(parts: Iterable[nn.Module], mean: np.ndarray, scale: np.ndarray) -> Actor:
    """The linear layers among `parts` as plain arrays, with the scaling of their observations."""
    layers = tuple(
        (part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy())
        for part in parts
        if isinstance(part, nn.Linear)
    )
    return Actor(mean.astype(float), scale.astype(float), OBSERVATION_CLIP, layers, MEAN_CLIP)


def mean_and_scale(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each column; the latter is at least `SMALLEST_SCALE`."""
    values = values.astype(float)
    return values.mean(axis=0), np.maximum(values.std(axis=0), SMALLEST_SCALE)


def scaled(values: np.ndarray, mean: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Scale and clip values for a network, as in `Actor`."""
    return np.clip((values - mean) / scale, -OBSERVATION_CLIP, OBSERVATION_CLIP)
