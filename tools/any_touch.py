"""A second decision in HPAC-GraspAny-v1: learned from each observation of a closed hand whether to
close again, with and without memory of the closing; ``python -m tools.any_closures touch``."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpac_gym.evaluation.seeds import BENCHMARK_SEED
from hpac_gym.model import HPAC
from hpac_gym.output import replacing
from hpac_gym.policies import read_policy
from hpac_gym.tasks.grasp_any import GraspAny
from hpac_gym.tasks.scripted import THUMB_OPPOSED, ScriptedGraspAny
from hpac_gym.tasks.senses import LOAD_TERMS
from hpac_gym.tasks.terms import Layout
from tools.any_player import Act, Player

Closing = Callable[[float], NDArray]
"""Function from the control steps since the closing began, in a closing's own time, to actions,
shape (n, 6).
"""


LOOKS = (0, 6, 12, 18, 24, 30)
"""Control steps whose observations a decision may use: all of them with memory, otherwise the first
and the last.
"""
DECIDED = LOOKS[-1]
"""Control step of the second decision, when the hand has closed."""
CHOICES = ("keep", "squeeze", "again")
"""Keep still; close further by `SQUEEZE`; open for `OPENING` control steps, then close as the
policy decides on what is seen by then, `HASTE` times as fast, so that the hand has closed before
the lift."""
POLICY = "grasp-any"
SQUEEZE = 0.3
OPENING = 11
HASTE = 1.5
OPEN = np.append(-np.ones(5), 2 * THUMB_OPPOSED / HPAC.synergy_max[-1] - 1).astype(np.float32)
"""Action of the open hand with its thumb opposed."""
RUNS = 3
TRAINING_EPISODES = 320
"""Disjoint training sets and their episodes; each episode runs with every choice, 97 steps each:
93,000 steps a set.
"""
UPDATES = 80
"""Updates of each network; chosen, like size and dropout, on training episodes only, one set
predicting the next.
"""


@dataclass(frozen=True, slots=True)
class Trials:
    """Episodes in which the hand has closed, run with each of the choices.

    Attributes:
        seen: observations at the steps `LOOKS`, shape (n, len(LOOKS), observed).
        won: success of each choice, shape (n, len(CHOICES)).
    """

    seen: NDArray
    won: NDArray[np.bool_]


def trials_of(player: Player, first: str, seeds: range, folder: Path) -> Trials:
    """Read trials with a first closure of `FIRST` from files in the folder, one per batch of seeds;
    missing ones are run.
    """
    parts = []
    for start in range(seeds.start, seeds.stop, player.count):
        part = range(start, min(start + player.count, seeds.stop))
        path = folder / f"{player.name}-{first}-{part.start}-{part.stop}.npz"
        if not path.exists():
            looks: dict[int, dict[int, NDArray]] = defaultdict(dict)
            won = np.array(
                [
                    player.play(part, partial(_decided, player.task, first, choice, looks))
                    for choice in CHOICES
                ]
            ).T
            with replacing(path) as temporary:
                np.savez(
                    temporary,
                    seen=np.array([[*looks[place].values()] for place in range(len(part))]),
                    won=won,
                )
        with np.load(path) as kept:
            parts.append((kept["seen"], kept["won"]))
    return Trials(*map(np.concatenate, zip(*parts, strict=True)))


def by_policy(task: GraspAny, seen: NDArray, file: Path = POLICY) -> Closing:
    """The closures that a policy decides on first observations."""
    policy = cached_policy(file)
    deployed = Layout(task.terms, 1).space.shape[0]
    decisions = np.array([policy.actor(row[:deployed]) for row in seen])
    return lambda step: policy.closures.actions(decisions, np.full(len(seen), step)).astype(
        np.float32
    )


def by_script(task: GraspAny, seen: NDArray) -> Closing:
    """The closures that the script chooses on first observations; its steps are asked for in their
    order.
    """
    scripts = [ScriptedGraspAny(task.terms) for _ in seen]
    for script in scripts:
        script.reset()
    return lambda step: np.array(
        [script.act(row) for script, row in zip(scripts, seen, strict=True)]
    )


cached_policy = cache(read_policy)
FIRST = {"policy": by_policy, "script": by_script}
"""Who decides on the first closure."""


def _decided(
    task: GraspAny,
    first: str,
    choice: str,
    looks: dict[int, dict],
    seen_first: NDArray,
    places: NDArray,
) -> Act:
    """A first closure and a choice after `DECIDED` steps; `looks` gets the observations at the
    steps `LOOKS` of each episode.

    The policy decides again as at the start of an episode: all but the object is as it was then.
    """
    slices = Layout(task.terms, 1).slices
    columns = slice(slices["object_pos"].start, slices["object_seen"].stop)
    closing = FIRST[first](task, seen_first)
    again = None

    def act(step: int, seen: NDArray) -> NDArray:
        nonlocal again
        if step in LOOKS:
            for place, row in zip(places.tolist(), seen, strict=True):
                looks[place][step] = row.copy()
        if choice == "again" and step >= DECIDED:
            if step < DECIDED + OPENING:
                return np.tile(OPEN, (len(seen), 1))
            if again is None:
                begun = seen_first.copy()
                begun[:, columns] = seen[:, columns]
                again = by_policy(task, begun)
            return again(HASTE * (step - DECIDED - OPENING))
        actions = closing(step)
        if choice == "squeeze" and step >= DECIDED:
            actions[:, :5] = np.minimum(
                actions[:, :5] + SQUEEZE * min((step - DECIDED + 1) / 8, 1.0), 1.0
            )
        return actions

    return act


def chances(seen: NDArray, won: NDArray, asked: NDArray, seed: int) -> NDArray:
    """Success probability of each choice, learned from trials by five small networks.

    Args:
        seen: observations of the training episodes, shape (n, k).
        won: their successes, shape (n, m).
        asked: observations of the evaluated episodes, shape (l, k).
        seed: seed of the networks.

    Returns:
        Probabilities, shape (l, m).
    """
    import torch
    from torch import nn

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    mean = seen.mean(0)
    scale = np.maximum(seen.std(0), 0.05)
    known, new = (
        torch.tensor(np.clip((values - mean) / scale, -5, 5), dtype=torch.float32)
        for values in (seen, asked)
    )
    target = torch.tensor(won, dtype=torch.float32)
    shares = np.zeros((len(asked), won.shape[1]))
    for _ in range(5):
        net = nn.Sequential(
            nn.Dropout(0.5),
            nn.Linear(known.shape[1], 16),
            nn.SiLU(),
            nn.Linear(16, target.shape[1]),
        )
        optimizer = torch.optim.AdamW(net.parameters(), lr=3e-3, weight_decay=0.3)
        for _ in range(UPDATES):
            optimizer.zero_grad()
            nn.functional.binary_cross_entropy_with_logits(net(known), target).backward()
            optimizer.step()
        with torch.no_grad():
            shares += net.eval()(new).sigmoid().numpy() / 5
    return shares


def arms(seen: NDArray, task: GraspAny) -> dict[str, NDArray]:
    """Inputs of the decision by their name, each of shape (n, k), from observations of shape (n,
    len(LOOKS), observed).
    """
    deploy = sum(len(term.labels) for term in task.terms)
    load = deploy + sum(len(term.labels) for term in LOAD_TERMS)
    everything = np.arange(seen.shape[2])
    parts = {
        "deploy": everything[:deploy],
        "load": everything[:load],
        "privileged": np.delete(everything, range(deploy, load)),
    }
    times = {"": [0, -1], ", memory": slice(None)}
    pairs = (
        (name + memory, seen[:, looks][..., part])
        for name, part in parts.items()
        for memory, looks in times.items()
    )
    return {name: values.reshape(len(seen), -1) for name, values in pairs}


def _mean(values: NDArray) -> str:
    """Mean over runs and episodes, shape (runs, episodes), with a 95 % bootstrap interval over
    both.
    """
    rng = np.random.default_rng(0)
    (runs, episodes) = values.shape
    drawn = [
        values[rng.integers(runs, size=runs)][:, rng.integers(episodes, size=episodes)].mean()
        for _ in range(2_000)
    ]
    low, high = np.percentile(drawn, (2.5, 97.5))
    return f"{values.mean():.3f} [{low:.3f}, {high:.3f}]"


def touch(episodes: int, folder: Path, first: str, varied_hands: bool) -> Iterator[str]:
    """Markdown table of the success of the second decision by its observation, on held-out and on
    real objects.

    With ``varied_hands``, the decision is learned with the training hands and evaluated with the
    held-out ones. The last columns measure how well each observation predicts success if the hand
    keeps still: the loss is the mean negative log-likelihood of the outcome."""
    hands = ("train", "test") if varied_hands else ("nominal", "nominal")
    player = Player("train", hands=hands[0])
    trained = trials_of(player, first, range(RUNS * TRAINING_EPISODES), folder)
    runs = [slice(run * TRAINING_EPISODES, (run + 1) * TRAINING_EPISODES) for run in range(RUNS)]
    seeds = range(BENCHMARK_SEED, BENCHMARK_SEED + episodes)
    parts = [
        trials_of(Player(objects, hands=hands[1]), first, seeds, folder)
        for objects in ("test", "real")
    ]
    judged = np.concatenate([part.won for part in parts])
    places = np.arange(2 * episodes)
    known = arms(trained.seen, player.task)
    asked = arms(np.concatenate([part.seen for part in parts]), player.task)
    best = [int(trained.won[run].mean(0).argmax()) for run in runs]
    won = {
        f"nothing: {choice}": np.tile(held, (RUNS, 1))
        for choice, held in zip(CHOICES, judged.T, strict=True)
    }
    won["nothing: what was best in training"] = judged[:, best].T
    loss = {}
    for name in known:
        odds = np.array(
            [
                chances(known[name][run], trained.won[run], asked[name], seed)
                for seed, run in enumerate(runs)
            ]
        )
        won[name] = judged[places, odds.argmax(2)]
        loss[name] = -np.log(np.where(judged[:, 0], odds[:, :, 0], 1 - odds[:, :, 0]))
    won["the outcome itself"] = np.tile(judged.any(1), (RUNS, 1))
    yield "| decided on | held-out objects | over *deploy* | real objects | over *deploy* | loss of foretelling | over *deploy* |"
    yield "| --- " * 7 + "|"
    for name, values in won.items():
        halves = [
            (values[:, part].astype(float), won["deploy"][:, part])
            for part in (slice(episodes), slice(episodes, None))
        ]
        cells = [text for mine, deploy in halves for text in (_mean(mine), _mean(mine - deploy))]
        cells += (
            [_mean(loss[name]), _mean(loss[name] - loss["deploy"])] if name in loss else ["", ""]
        )
        yield f"| {name} | {' | '.join(cells)} |"
