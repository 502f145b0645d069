"""Behaviour cloning: ``python -m agents.clone DATASET --out runs/clone``, from a dataset of ``hpac record``.

A network imitates the actions of the successful episodes. The folder gets ``policy.zip``, which is evaluated, replayed
and exported like any other.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
from gymnasium.spaces import Box

from agents import POLICY, RunError, command_parser, target_of, versions
from hpac import run, whole_number
from hpac_gym.evaluation.dataset import read_dataset
from hpac_gym.output import writable_folder
from hpac_gym.policies import Actor, PolicyFile, write_policy
from hpac_gym.progress import progress

HIDDEN = (256, 256)
BATCH = 256
KEPT = 0.1  # share of the episodes, the last ones, that is held out for evaluation


def clone(observations: list[np.ndarray], actions: list[np.ndarray], epochs: int, seed: int) -> tuple[Actor, float]:
    """Fit an actor to episodes.

    Args:
        observations: observations of each episode, shape (steps, n).
        actions: actions of each episode, shape (steps, m), −1…1.
        epochs: number of passes over the data.
        seed: seed of the weights and of the order.

    Returns:
        The actor, and its root-mean-square error on the held-out episodes; NaN if there are none.
    """
    import torch
    from torch import nn

    from agents.closures import MEAN_CLIP, actor_of, mean_and_scale, scaled

    torch.set_num_threads(1)
    torch.manual_seed(seed)
    used = len(observations) - int(KEPT * len(observations))
    seen, done = np.concatenate(observations[:used]), np.concatenate(actions[:used])
    mean, scale = mean_and_scale(seen)
    inputs = torch.from_numpy(scaled(seen, mean, scale).astype(np.float32))
    wanted = torch.from_numpy(done)
    widths = (seen.shape[1], *HIDDEN, done.shape[1])
    network = nn.Sequential(*(part for a, b in pairwise(widths) for part in (nn.Linear(a, b), nn.ReLU())))[:-1]
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs)
    for _ in progress(range(epochs), "epochs"):
        for rows in torch.randperm(len(inputs)).split(BATCH):
            loss = nn.functional.mse_loss(torch.tanh(network(inputs[rows]).clamp(-MEAN_CLIP, MEAN_CLIP)), wanted[rows])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        schedule.step()
    actor = actor_of(network, mean, scale)
    judged = zip(observations[used:], actions[used:], strict=True)
    errors = [actor(row) - action for pair in judged for row, action in zip(*pair, strict=True)]
    return actor, float(np.sqrt(np.mean(np.square(errors)))) if errors else float("nan")


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.clone", __doc__)
    parser.add_argument("dataset", type=Path, help="folder that hpac record wrote")
    parser.add_argument("--out", type=Path, required=True, help="folder of the policy")
    parser.add_argument("--epochs", type=whole_number(1), default=30, help="number of passes over the data")
    parser.add_argument("--seed", type=whole_number(0), default=0, help="seed of the weights and of the order")
    args = parser.parse_args(argv)
    dataset = read_dataset(args.dataset)
    if not isinstance(dataset.observation_space, Box):
        raise RunError(f"'{args.dataset}' observes {dataset.observation_space}: cloning needs one flat box")
    writable_folder(args.out)
    episodes = [episode for episode in dataset.iterate_episodes() if episode.infos["is_success"][-1]]
    if not episodes:
        raise RunError(f"'{args.dataset}' has no successful episode among its {dataset.total_episodes}: nothing to clone")
    target = target_of(dataset.env_spec.id, **dataset.env_spec.kwargs)
    actor, error = clone([e.observations[:-1] for e in episodes], [e.actions for e in episodes], args.epochs, args.seed)
    about = {
        **target,
        "algorithm": "behaviour cloning",
        "settings": {"dataset": str(dataset.id), "epochs": args.epochs, "seed": args.seed, "hidden": HIDDEN},
        "episodes": len(episodes),
        "versions": versions(),
    }
    write_policy(args.out / POLICY, PolicyFile(actor, about))
    kept = f"the last {int(KEPT * len(episodes))} kept back, error {error:.3f}" if np.isfinite(error) else "none kept back"
    print(f"{len(episodes)} successful episodes, {kept}: {args.out / POLICY}")
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
