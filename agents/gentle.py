"""A policy for the gentle task: ``python -m agents.gentle --out runs/gentle``.

The hand is moved by increments. A network learns what a rule that feels the true contact forces
would have done, on what it does itself (DAgger, Ross et al. 2011); with ``--steps`` PPO of
Stable-Baselines3 goes on from there, whose critic also sees the true forces. The folder gets
``policy.hpac``."""

import sys
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnvWrapper
from torch import nn

from agents import POLICY, RunError, target_of
from agents.gentle_rule import CLOSING, MOVES, PER_RADIAN, RULE, STEPS, UNTOLD
from agents.networks import (
    MEAN_CLIP,
    OBSERVATION_CLIP,
    actor_of,
    descend,
    mean_and_scale,
    scaled,
)
from hpac_gym.command import add_counts, command_parser, run
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.evaluation.environment import versions
from hpac_gym.evaluation.seeds import training_seed
from hpac_gym.model import Array, synergy_from_action
from hpac_gym.output import writable_folder
from hpac_gym.physics.settings import BODIES
from hpac_gym.policies import PolicyFile, write_policy
from hpac_gym.registration import GENTLE

WORLDS = 128
HIDDEN = 128
UPDATES = 250
"""Of a round of imitation; the last has three times as many."""
WARMING = 10
"""First rollouts, in which the critic alone learns."""


class Hands(VecEnvWrapper):
    """n hands that are moved by increments; they see what `Increments.shown` gives, scaled, and then
    what only a critic may. An action is a decision before its tanh.

    Attributes:
        seen: number of entries that the actor sees.
        recent: what every episode has seen and done.
        mean, scale: of what the actor sees, shape (seen,).
        ended, steps: episodes and control steps so far, over all hands.
    """

    def __init__(self, num_envs: int, obs: str, told: bool = True, body: str = "light") -> None:
        env = HandVecEnv(GENTLE, num_envs, engine="mujoco", body=body, obs=obs, told=told)
        self.told = told
        self.episodes = env.envs.episodes
        self.recent = MOVES.begin(np.zeros((num_envs, env.observation_space.shape[0]), np.float32))
        self.seen = MOVES.shown(self.recent).shape[1]
        self.mean = np.zeros(self.seen)
        self.scale = np.ones(self.seen)
        self.ended = self.steps = 0
        size = self.seen + self._truth().shape[1]
        super().__init__(
            env,
            Box(-OBSERVATION_CLIP, OBSERVATION_CLIP, (size,), np.float32),
            Box(-MEAN_CLIP, MEAN_CLIP, (6,), np.float32),
        )

    def reset(self) -> Array:
        self.recent = MOVES.begin(self.venv.reset())
        return self._observed()

    def step_async(self, actions: Array) -> None:
        self.recent = MOVES.move(self.recent, np.tanh(actions))
        self.venv.step_async(self.recent.action.astype(np.float32))

    def step_wait(self) -> Any:
        seen, reward, done, infos = self.venv.step_wait()
        self.ended += int(done.sum())
        self.steps += len(done)
        self.recent = MOVES.see(self.recent, seen)
        begun = MOVES.begin(seen[done])
        for entry in fields(begun):
            getattr(self.recent, entry.name)[done] = getattr(begun, entry.name)
        # No episode is truncated, so that nobody reads the last observations in the infos.
        return self._observed(), 0.1 * reward, done, infos

    def _observed(self) -> Array:
        shown = scaled(MOVES.shown(self.recent), self.mean, self.scale)
        return np.concatenate([shown, self._truth()], axis=1).astype(np.float32)

    def _truth(self) -> Array:
        """What a critic sees beside: forces, squeeze, limit, slip, mass, friction; of order one."""
        task = self.episodes.task
        now = self.episodes.now
        if now is None:
            return np.zeros((len(self.recent.step), 11))
        things = [setup.object for setup in self.episodes.setups]
        rows = (task.squeeze / 3, task.crush_limit / 5, 20 * task.grip.slip)
        hidden = ([one.mass / 0.1 for one in things], [one.friction for one in things])
        return np.column_stack([now.state.contact_force / 3, *rows, *hidden])

    def taught(self) -> Array:
        """Decisions of the rule, which knows everything but an untold limit, shape (n, 6)."""
        state = self.episodes.now.state
        task = self.episodes.task
        setups = self.episodes.setups
        step = self.recent.step[:, 0]
        far = np.array([one.position[0] + one.object.half_extents[0] for one in setups])
        limit = task.crush_limit if self.told else np.full(len(setups), UNTOLD)
        synergy = synergy_from_action(self.recent.action)
        slip = task.grip.slip * (step > CLOSING)
        moved = RULE.increments(synergy, step, state.contact_force, limit, far, slip)
        return MOVES.decisions(moved * PER_RADIAN)


class Sides(nn.Module):
    """An actor's hidden layers, which see the first entries alone, and a critic's, which see all."""

    latent_dim_pi = latent_dim_vf = HIDDEN

    def __init__(self, seen: int, everything: int) -> None:
        super().__init__()
        self.seen = seen
        self.actor, self.critic = (
            nn.Sequential(nn.Linear(size, HIDDEN), nn.ReLU(), nn.Linear(HIDDEN, HIDDEN), nn.ReLU())
            for size in (seen, everything)
        )

    def forward(self, entries: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return self.forward_actor(entries), self.forward_critic(entries)

    def forward_actor(self, entries: torch.Tensor) -> torch.Tensor:
        return self.actor(entries[:, : self.seen])

    def forward_critic(self, entries: torch.Tensor) -> torch.Tensor:
        return self.critic(entries)


class Asymmetric(ActorCriticPolicy):
    """Stable-Baselines3's policy with `Sides`; `seen`: number of entries that the actor sees."""

    def __init__(self, *args: Any, seen: int, **settings: Any) -> None:
        self._seen = seen
        super().__init__(*args, **settings)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor = Sides(self._seen, self.features_dim)

    def mean(self, entries: torch.Tensor) -> torch.Tensor:
        """Mean decisions before their tanh."""
        return self.action_net(self.mlp_extractor.forward_actor(entries))


def learner(env: Hands, seed: int) -> PPO:
    """A PPO that has learned nothing yet."""
    return PPO(
        Asymmetric,
        env,
        n_steps=STEPS,
        batch_size=1024,
        n_epochs=5,
        learning_rate=1e-4,
        gamma=0.99,
        gae_lambda=0.95,
        target_kl=0.02,
        seed=seed,
        stats_window_size=2000,
        device="cpu",
        policy_kwargs={"seen": env.seen, "log_std_init": -2.5, "ortho_init": False},
    )


def imitate(model: PPO, env: Hands, rounds: int, seed: int) -> None:
    """DAgger: the policy learns what the rule would have done where the policy has been."""
    rng = np.random.default_rng(seed)
    policy = model.policy
    optimizer = torch.optim.Adam(policy.parameters(), lr=1e-3)
    shown: list[Array] = []
    wanted: list[Array] = []
    env.seed(training_seed(seed, 0, env.num_envs))
    env.reset()
    for number in range(rounds):
        ended = succeeded = 0
        for _ in range(STEPS):
            shown.append(MOVES.shown(env.recent))
            wanted.append(env.taught())
            raw = np.arctanh(np.clip(wanted[-1], -0.999, 0.999))
            if number:
                rows = torch.from_numpy(scaled(shown[-1], env.mean, env.scale)).float()
                raw = policy.mean(rows).clamp(-MEAN_CLIP, MEAN_CLIP).detach().numpy()
            *_, done, infos = env.step(raw)
            ended += int(done.sum())
            succeeded += sum(bool(infos[world]["is_success"]) for world in np.flatnonzero(done))
        if not number:
            env.mean, env.scale = mean_and_scale(np.concatenate(shown))
        data = torch.from_numpy(scaled(np.concatenate(shown), env.mean, env.scale)).float()
        told = torch.from_numpy(np.concatenate(wanted)).float()
        optimizer.param_groups[0]["lr"] = 1e-3 * (1 - number / rounds)
        count = UPDATES * (3 if number == rounds - 1 else 1)
        for part in rng.integers(len(data), size=(count, 1024)):
            decided = torch.tanh(policy.mean(data[part]).clamp(-MEAN_CLIP, MEAN_CLIP))
            loss = (decided - told[part]).square().mean()
            descend(optimizer, loss)
        print(f"round {number}: {succeeded} of {ended} held, loss {loss.item():.4f}", flush=True)


class Warm(BaseCallback):
    """Lets the critic alone learn for the first rollouts, and tells how training goes."""

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        number = self.num_timesteps // (STEPS * WORLDS)
        policy = self.model.policy
        learns = number > WARMING
        for part in (policy.mlp_extractor.actor, policy.action_net):
            part.requires_grad_(learns)
        policy.log_std.requires_grad_(learns)
        if number % 20 == 0:
            share = np.mean(self.model.ep_success_buffer)
            print(f"{self.num_timesteps:,} steps: {share:.3f} held in training", flush=True)


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("agents.gentle", __doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder of the policy")
    parser.add_argument("--obs", choices=("deploy", "load"), default="load", help="observation")
    add_counts(
        parser,
        seed=(0, 0, "of the training"),
        rounds=(1, 8, "rounds of imitation"),
        steps=(0, 0, "control steps of PPO"),
    )
    parser.add_argument("--untold", action="store_true", help="the crush limit is not told")
    parser.add_argument("--body", choices=tuple(BODIES), default="light", help="the hand's inertia")
    args = parser.parse_args(argv)
    path = args.out / POLICY
    told = not args.untold
    if path.exists():
        raise RunError(f"'{path}' is there already: choose another folder, or remove it")
    writable_folder(args.out)
    torch.set_num_threads(1)
    torch.manual_seed(args.seed)
    env = Hands(WORLDS, args.obs, told, args.body)
    model = learner(env, args.seed)
    imitate(model, env, args.rounds, args.seed)
    if args.steps:
        env.seed(training_seed(args.seed, 1, WORLDS))
        model.learn(args.steps, callback=Warm())
    settings = {name: getattr(args, name) for name in ("seed", "rounds", "steps", "body")}
    about = {
        **target_of(GENTLE, obs=args.obs, told=told),
        "algorithm": "DAgger, then PPO" if args.steps else "DAgger",
        "settings": settings | {"told": told, "hidden": [HIDDEN, HIDDEN]},
        "increments": asdict(MOVES),
        "episodes": env.ended,
        "control_steps": env.steps,
        "versions": versions("stable-baselines3"),
    }
    parts = [*model.policy.mlp_extractor.actor, model.policy.action_net]
    write_policy(path, PolicyFile(actor_of(parts, env.mean, env.scale), about))
    env.close()
    print(path)


if __name__ == "__main__":
    sys.exit(run(main))
