"""PPO in one file, on a batch of hands: `gymnasium.make_vec`, no other library for learning.

    python ppo.py --out runs/ppo --total-steps 2000000
    hpac evaluate --policy runs/ppo/policy.hpac --engine mujoco

Actions are the tanh of a normal distribution; observations are scaled by their running mean and
standard deviation; both are in the policy file, which needs neither PyTorch nor this script."""

import argparse
from dataclasses import dataclass, fields
from pathlib import Path

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.utils import RunningMeanStd
from torch import nn
from torch.distributions import Normal

from hpac_gym.policies import Actor, PolicyFile, write_policy
from hpac_gym.policies.made_for import made_for


@dataclass
class Settings:
    out: Path = Path("runs/ppo")
    env: str = "hpac_gym:HPAC-Grasp-v0"
    total_steps: int = 2_000_000
    num_envs: int = 64
    rollout: int = 64
    epochs: int = 10
    batch_size: int = 512
    learning_rate: float = 5e-4
    gamma: float = 0.97
    gae_lambda: float = 0.9
    clip: float = 0.2
    value_coef: float = 0.5
    max_grad_norm: float = 0.5
    seed: int = 0


def mlp(inputs: int, outputs: int) -> nn.Sequential:
    layers = [nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU()]
    return nn.Sequential(*layers, nn.Linear(128, outputs))


def train(s: Settings) -> Path:
    torch.manual_seed(s.seed)
    torch.set_num_threads(1)
    how = {"engine": "mujoco", "autoreset_mode": AutoresetMode.SAME_STEP}
    envs = gymnasium.make_vec(s.env, s.num_envs, **how)
    if not envs.single_observation_space.shape:
        raise SystemExit(f"error: env is {s.env!r}, whose observation is not a vector")
    observed = envs.single_observation_space.shape[0]
    acted = envs.single_action_space.shape[0]
    actor = mlp(observed, acted)
    critic = mlp(observed, 1)
    log_std = nn.Parameter(torch.full((acted,), -0.5))
    weights = [*actor.parameters(), *critic.parameters(), log_std]
    optimizer = torch.optim.Adam(weights, s.learning_rate)
    shape = (s.rollout, s.num_envs)
    seen = torch.zeros(*shape, observed)
    raw = torch.zeros(*shape, acted)
    density, rewards, ends, values = torch.zeros(4, *shape).unbind()
    statistics = RunningMeanStd(shape=(observed,))

    def scaled(observation: np.ndarray) -> torch.Tensor:
        statistics.update(observation)
        value = (observation - statistics.mean) / np.sqrt(statistics.var + 1e-4)
        return torch.from_numpy(np.clip(value, -8.0, 8.0).astype(np.float32))

    now = scaled(envs.reset(seed=s.seed)[0])
    won: list[bool] = []
    updates = max(s.total_steps // (s.rollout * s.num_envs), 1)
    for update in range(updates):
        optimizer.param_groups[0]["lr"] = s.learning_rate * max(1 - update / updates, 0.05)
        for step in range(s.rollout):
            seen[step] = now
            with torch.no_grad():
                normal = Normal(actor(now), log_std.exp())
                raw[step] = normal.sample()
                density[step] = normal.log_prob(raw[step]).sum(-1)
                values[step] = critic(now)[:, 0]
            observation, reward, done, cut, infos = envs.step(torch.tanh(raw[step]).numpy())
            now = scaled(observation)
            rewards[step] = torch.from_numpy(reward)
            ends[step] = torch.from_numpy(done | cut)
            if ends[step].any():
                won += infos["final_info"]["is_success"][done | cut].tolist()
        advantages = torch.zeros(shape)
        with torch.no_grad():
            following = critic(now)[:, 0]
        last = torch.zeros(s.num_envs)
        for step in reversed(range(s.rollout)):
            going = 1 - ends[step]
            error = rewards[step] + s.gamma * going * following - values[step]
            last = advantages[step] = error + s.gamma * s.gae_lambda * going * last
            following = values[step]
        columns = (seen, raw, density, advantages, advantages + values)
        data = [column.flatten(0, 1) for column in columns]
        for _ in range(s.epochs):
            for rows in torch.randperm(len(data[0])).split(s.batch_size):
                o, a, old, gain, wanted = (column[rows] for column in data)
                gain = (gain - gain.mean()) / (gain.std(correction=0) + 1e-8)
                ratio = (Normal(actor(o), log_std.exp()).log_prob(a).sum(-1) - old).exp()
                bounded = ratio.clamp(1 - s.clip, 1 + s.clip)
                policy_loss = -torch.min(ratio * gain, bounded * gain).mean()
                value_loss = (critic(o)[:, 0] - wanted).square().mean()
                optimizer.zero_grad()
                (policy_loss + s.value_coef * value_loss).backward()
                nn.utils.clip_grad_norm_(weights, s.max_grad_norm)
                optimizer.step()
        rate = f"{np.mean(won[-500:]):.0%} of the last episodes succeeded" if won else "none ended"
        print(f"{(update + 1) * s.rollout * s.num_envs:,} steps, {rate}", flush=True)
    scaling = statistics.mean, np.sqrt(statistics.var + 1e-4)
    envs.close()
    linear = [layer for layer in actor if isinstance(layer, nn.Linear)]
    layers = [(each.weight.detach().numpy(), each.bias.detach().numpy()) for each in linear]
    with gymnasium.make(s.env, engine="mujoco") as env:
        about = {"env_id": s.env, "made_for": made_for(env), "algorithm": "PPO"}
    s.out.mkdir(parents=True, exist_ok=True)
    write_policy(s.out / "policy.hpac", PolicyFile(Actor(*scaling, 8.0, tuple(layers), 4.0), about))
    return s.out / "policy.hpac"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for entry in fields(Settings):
        option = f"--{entry.name.replace('_', '-')}"
        parser.add_argument(option, type=type(entry.default), default=entry.default)
    print(train(Settings(**vars(parser.parse_args()))))
