"""One-step SAC in one file: learn to grasp with one decision an episode, a closure of the hand.

    python one_step_sac.py --out runs/bandit --episodes 20000
    hpac evaluate --policy runs/bandit/policy.hpac --engine mujoco

A contextual bandit: context = first observation, arm = closure, return = success. The critics see
the whole simulation state; they are a survival model of the task's phases. The actor sees what a
real hand does. `agents.train` adds checkpoints, an auxiliary loss and acceptance of episodes."""

import argparse
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import gymnasium
import numpy as np
import torch
from torch import nn
from torch.nn.functional import binary_cross_entropy_with_logits, logsigmoid, softplus

from hpac_gym.policies import Actor, Closures, PolicyFile, write_policy
from hpac_gym.policies.made_for import made_for


@dataclass
class Settings:
    out: Path = Path("runs/bandit")
    env: str = "hpac_gym:HPAC-Grasp-v0"
    episodes: int = 20_000
    random_episodes: int = 2_000
    num_envs: int = 64
    updates_per_episode: float = 0.15
    batch_size: int = 256
    learning_rate: float = 1e-3
    pessimism: float = 0.5  # standard deviations over the critics, subtracted from their mean
    target_entropy: float = -1.0  # at the end; nats for each number of a closure
    seed: int = 0


def mlp(inputs: int, outputs: int) -> nn.Sequential:
    layers = [nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU()]
    return nn.Sequential(*layers, nn.Linear(256, outputs))


def sample(actor: nn.Module, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Decisions −1…1 of a tanh-squashed normal distribution, and their log-density."""
    mean, log_std = actor(seen).clamp(-4, 4).chunk(2, -1)
    log_std = log_std.clamp(max=0.5)
    noise = torch.randn_like(mean)
    raw = mean + log_std.exp() * noise
    squash = 2 * (np.log(2) - raw - softplus(-2 * raw))
    density = -0.5 * noise**2 - log_std - 0.5 * np.log(2 * np.pi) - squash
    return torch.tanh(raw), density.sum(-1)


def train(s: Settings) -> Path:
    torch.manual_seed(s.seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(s.seed)
    closures = Closures()
    decided = len(closures.names)
    how = {"engine": "mujoco", "obs": "privileged", "autoreset_mode": "Disabled"}
    envs = gymnasium.make_vec(s.env, s.num_envs, **how)
    if envs.single_action_space.shape != (6,) or not envs.single_observation_space.shape:
        raise SystemExit(f"error: env is {s.env!r}: a closure sees a vector and gives six actions")
    task = envs.get_attr("task")[0]
    phases = torch.arange(len(task.phases))
    observed = envs.single_observation_space.shape[0]
    deployed = sum(len(term.labels) for term in task.terms)  # the first entries
    critics = nn.ModuleList(mlp(observed + decided, len(phases)) for _ in range(2))
    actor = mlp(deployed, 2 * decided)
    log_alpha = torch.tensor(-3.0, requires_grad=True)
    critic_optimizer = torch.optim.AdamW(critics.parameters(), s.learning_rate, weight_decay=0.03)
    actor_groups = [{"params": actor.parameters()}, {"params": [log_alpha], "lr": 1e-2}]
    actor_optimizer = torch.optim.Adam(actor_groups, s.learning_rate)
    seen = np.zeros((s.episodes + s.num_envs, observed), np.float32)
    decisions = np.zeros((len(seen), decided), np.float32)
    survived = np.zeros(len(seen), np.int64)
    random_episodes = min(s.random_episodes, s.episodes)
    count = updates = 0

    def scaled(rows: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.clip((rows - mean) / scale, -8, 8))

    def update(target_entropy: float) -> None:
        for critic in critics:
            rows = rng.integers(count, size=s.batch_size)
            odds = critic(torch.cat([scaled(seen[rows]), torch.from_numpy(decisions[rows])], -1))
            lasted = torch.from_numpy(survived[rows])[:, None]
            loss = binary_cross_entropy_with_logits(odds, 1.0 * (lasted > phases), reduction="none")
            ((lasted >= phases) * loss).sum(-1).mean().backward()  # phases that it reached
        critic_optimizer.step()
        context = scaled(seen[rows])
        chosen, density = sample(actor, context[:, :deployed])
        inputs = torch.cat([context, chosen], -1)
        held = torch.stack([logsigmoid(critic(inputs)).sum(-1) for critic in critics])
        held = held.mean(0) - s.pessimism * held.std(0, correction=0)
        actor_loss = (log_alpha.exp().detach() * density - held).mean()
        alpha_loss = log_alpha.exp() * (-density.mean().detach() - target_entropy)
        actor_optimizer.zero_grad()
        (actor_loss + alpha_loss).backward()
        actor_optimizer.step()
        critic_optimizer.zero_grad()  # the actor's loss has a gradient there too

    first = np.zeros((s.num_envs, observed), np.float32)
    arms = np.zeros((s.num_envs, decided))
    steps = np.zeros(s.num_envs, int)
    over = np.ones(s.num_envs, bool)
    while count < s.episodes:
        if over.any():  # begin episodes where the last ones have ended
            seeds = rng.integers(1_000_000, size=s.num_envs).tolist()  # others are held out
            first[over] = envs.reset(seed=seeds, options={"reset_mask": over})[0][over]
            steps[over] = 0
            arms[over] = rng.uniform(-1, 1, (over.sum(), decided))
            if updates:
                arms[over] = sample(actor, scaled(first[over])[:, :deployed])[0].detach().numpy()
        _, _, over, _, infos = envs.step(closures.actions(arms, steps).astype(np.float32))
        steps += 1
        for world in np.flatnonzero(over):
            seen[count] = first[world]
            decisions[count] = arms[world]
            won = infos["is_success"][world]
            survived[count] = len(phases) if won else task.phases.index(infos["phase"][world])
            count += 1
            if count % 500 == 0:
                recent = (survived[count - 500 : count] == len(phases)).mean()
                print(f"{count:,} episodes, {recent:.0%} of the last 500 succeeded", flush=True)
        if count >= random_episodes and not updates:
            mean = seen[:count].mean(0)
            scale = np.maximum(seen[:count].std(0), 0.05)
        while random_episodes <= count and updates < count * s.updates_per_episode:
            update(decided * s.target_entropy * min(count / s.episodes, 1.0))
            updates += 1
    envs.close()
    linear = [layer for layer in actor if isinstance(layer, nn.Linear)]
    layers = [(each.weight.detach().numpy(), each.bias.detach().numpy()) for each in linear]
    layers[-1] = tuple(array[:decided] for array in layers[-1])  # the mean, without exploration
    scaling = mean[:deployed].astype(float), scale[:deployed].astype(float)
    with gymnasium.make(s.env, engine="mujoco") as env:
        about = {"env_id": s.env, "made_for": made_for(env), "closure": asdict(closures)}
    s.out.mkdir(parents=True, exist_ok=True)
    write_policy(s.out / "policy.hpac", PolicyFile(Actor(*scaling, 8.0, tuple(layers), 4.0), about))
    return s.out / "policy.hpac"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for entry in fields(Settings):
        option = f"--{entry.name.replace('_', '-')}"
        parser.add_argument(option, type=type(entry.default), default=entry.default)
    print(train(Settings(**vars(parser.parse_args()))))
