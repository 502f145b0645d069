"""Behaviour cloning: ``python -m agents.clone DATASET --out runs/clone``, from a dataset of ``hpac
record``.

A network imitates the actions of the successful episodes. With ``--rounds N`` it then acts itself,
N times in 200 episodes, and also learns what ``--expert`` would have done there (DAgger, Ross et
al. 2011): otherwise it sees no errors of its own. The folder gets ``policy.hpac``, updated before
every round, which is evaluated, replayed and exported like any other."""

import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from agents import POLICY, RunError, target_of
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.evaluation.dataset import read_dataset
from hpac_gym.evaluation.environment import make_env, versions
from hpac_gym.evaluation.episodes import run_episodes, worlds
from hpac_gym.evaluation.seeds import training_seed
from hpac_gym.output import writable_folder
from hpac_gym.policies import Actor, LearnedPolicy, PolicyFile, write_policy
from hpac_gym.policies.loading import load_policy
from hpac_gym.policies.made_for import vector_size
from hpac_gym.policies.policy import vector
from hpac_gym.progress import progress

HIDDEN = (256, 256)
BATCH = 256
KEPT = 0.1  # share of the episodes, the last ones, that is held out for evaluation
VISITS = 200  # episodes of a round

Pairs = tuple[np.ndarray, np.ndarray]
"""Observations, shape (steps, n), and actions, shape (steps, m), −1…1."""


def visit(
    actor: Actor, expert: str, env_id: str, options: dict[str, Any], first_seed: int
) -> Pairs:
    """Let an actor act for `VISITS` episodes; returns what it saw, and what the expert would have
    done.
    """
    visits: dict[int, list[tuple[np.ndarray, np.ndarray]]] = {}
    won = 0
    with worlds(env_id, options, VISITS) as (env, envs):
        experts = [load_policy(expert, env) for _ in range(envs.num_envs)]
        states: list[Any] = [None] * envs.num_envs
        policies = [LearnedPolicy(actor)] * envs.num_envs
        for step in run_episodes(envs, policies, range(first_seed, first_seed + VISITS)):
            won += step.over and step.success
            if step.number == 0:
                states[step.world] = None
            if not step.over:
                wanted, states[step.world] = experts[step.world].predict(
                    step.observation, states[step.world]
                )
                visits.setdefault(step.world, []).append((vector(step.observation), wanted))
    if not sys.stderr.isatty():  # a terminal has a progress bar
        print(f"in training, {won / VISITS:.0%} of {VISITS} episodes won", file=sys.stderr)
    pairs = [pair for _, seen in sorted(visits.items()) for pair in seen]
    return tuple(map(np.stack, zip(*pairs, strict=True)))


def clone(
    episodes: list[Pairs],
    epochs: int,
    seed: int,
    rounds: int = 0,
    more: Callable[[Actor, int], Pairs] | None = None,
) -> tuple[Actor, float]:
    """Fit an actor to episodes.

    Args:
        episodes: observations and actions of each episode.
        epochs: number of passes over the data, in total and in each round.
        seed: seed of the weights and of the order.
        rounds: number of times that data are added, after a first fit.
        more: returns them for an actor and the number of the round.

    Returns:
        The actor, and its root-mean-square error on the held-out episodes; NaN if there are none.
    """
    import torch
    from torch import nn

    from agents.networks import MEAN_CLIP, actor_of, descend, mean_and_scale, scaled

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    used = len(episodes) - int(KEPT * len(episodes))
    seen, done = map(np.concatenate, zip(*episodes[:used], strict=True))
    mean, scale = mean_and_scale(seen)
    widths = (seen.shape[1], *HIDDEN, done.shape[1])
    network = nn.Sequential(
        *(part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU()))
    )[:-1]
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs * (rounds + 1))
    for epoch in progress(range(epochs * (rounds + 1)), "epochs"):
        if epoch % epochs == 0:
            if epoch:
                added = more(actor_of(network, mean, scale), epoch // epochs)
                seen, done = map(np.concatenate, zip((seen, done), added, strict=True))
            inputs = torch.from_numpy(scaled(seen, mean, scale).astype(np.float32))
            wanted = torch.from_numpy(done)
        for rows in torch.randperm(len(inputs)).split(BATCH):
            loss = nn.functional.l1_loss(
                torch.tanh(network(inputs[rows]).clamp(-MEAN_CLIP, MEAN_CLIP)), wanted[rows]
            )
            descend(optimizer, loss)
        schedule.step()
    actor = actor_of(network, mean, scale)
    errors = [
        actor(row) - action for pair in episodes[used:] for row, action in zip(*pair, strict=True)
    ]
    return actor, float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("agents.clone", __doc__)
    parser.add_argument("dataset", type=Path, help="folder that hpac record wrote")
    parser.add_argument("--out", type=Path, required=True, help="folder of the policy")
    add_counts(
        parser,
        epochs=(1, 30, "number of passes over the data, also in each round"),
        rounds=(0, 0, "number of rounds in which it acts itself"),
        seed=(0, 0, "seed of weights, order and rounds"),
    )
    parser.add_argument(
        "--expert",
        default="scripted",
        help="whom it imitates in the rounds: scripted, or a policy file",
    )
    args = parser.parse_args(argv)
    dataset = read_dataset(args.dataset)
    if vector_size(dataset.observation_space) is None:
        raise RunError(
            f"'{args.dataset}' observes {dataset.observation_space}: cloning needs vectors"
        )
    if (args.out / POLICY).exists():
        raise RunError(
            f"'{args.out / POLICY}' is there already: choose another folder, or remove it"
        )
    writable_folder(args.out)
    try:
        episodes = [
            episode for episode in dataset.iterate_episodes() if episode.infos["is_success"][-1]
        ]
    except Exception as error:  # a damaged file can make its reader raise anything
        raise RunError(f"cannot read the episodes of '{args.dataset}': {error!r}") from None
    if not episodes:
        raise RunError(
            f"'{args.dataset}' has no successful episode among its {dataset.total_episodes}: nothing to clone"
        )
    env_id = dataset.env_spec.id
    options = dataset.env_spec.kwargs
    target = target_of(env_id, **options)
    if args.rounds:
        with make_env(target["env_id"], **options) as env:
            load_policy(args.expert, env)  # errors are raised here, not after the first fit
    settings = {name: getattr(args, name) for name in ("epochs", "rounds", "expert", "seed")}

    def save(actor: Actor, rounds: int) -> None:
        about = {
            **target,
            "algorithm": "behaviour cloning",
            "settings": {"dataset": str(dataset.id), **settings, "hidden": HIDDEN},
            "episodes": len(episodes) + VISITS * rounds,
            "versions": versions(),
        }
        write_policy(args.out / POLICY, PolicyFile(actor, about))

    def more(actor: Actor, number: int) -> Pairs:
        save(actor, number - 1)
        return visit(
            actor, args.expert, target["env_id"], options, training_seed(args.seed, number, VISITS)
        )

    pairs = [(vector(episode.observations)[:-1], episode.actions) for episode in episodes]
    if not all(
        np.isfinite(seen).all() and (np.abs(actions) <= 1.0).all() for seen, actions in pairs
    ):
        raise RunError(
            f"'{args.dataset}' has observations that are not finite, or actions outside −1…1"
        )
    actor, error = clone(pairs, args.epochs, args.seed, args.rounds, more)
    save(actor, args.rounds)
    kept = (
        f"the last {int(KEPT * len(episodes))} kept back, error {error:.3f}"
        if np.isfinite(error)
        else "none kept back"
    )
    print(f"{len(episodes)} successful episodes, {kept}: {args.out / POLICY}")


if __name__ == "__main__":
    sys.exit(run(main))
