"""Does feeling pay? Baselines and learned policies on the gentle task:
``python -m experiments.gentle rows|train|judge``.

Every policy moves the hand by increments of its synergy, 20 a second, from the same open posture.
*teacher* reads the true contact forces, which no hand has; the learned ones imitate it on what they
do themselves (DAgger), and then improve by PPO, once with ``obs="deploy"`` and once with
``obs="load"``. Choose on training seeds; `judge` uses held-out ones."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import VecEnvWrapper

import hpac_gym
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.model import HPAC, action_from_synergy
from hpac_gym.model.checks import Array
from hpac_gym.tasks.gentle import Gentle
from hpac_gym.tasks.task import open_hand

ID = "Gentle-v0"
hpac_gym.register(ID, Gentle, max_episode_steps=81)
STEPS = 80
OPEN = open_hand(1.2)
LARGEST = np.array([0.06, 0.10, 0.10, 0.10, 0.10, 0.10])
"""Largest increment of each driven joint [rad]; a learned policy's actions are its square roots, so
that small steps are as easy to find as large ones."""
STACK = 4


@dataclass(frozen=True, slots=True)
class Rule:
    """Numbers of the loop: close fast to just before contact, then by what each digit feels."""

    fast: float = 0.5
    """Synergy until which the fingers close fast, for an object 50 mm from the palm [rad]."""
    fastx: float = 4.0
    """By how much less for each metre more [rad/m]."""
    fstep: float = 0.06
    step: float = 0.015
    back: float = 0.01
    """Increments: fast, largest closing and largest opening one [rad]."""
    gain: float = 0.01
    """Increment for a newton that is missing [rad/N]."""
    cmc: float = 1.2
    tpre: float = 0.1
    tstep: float = 0.03
    """CMC; MP up to which the thumb closes fast, and how fast [rad]."""
    delay: float = 8.0
    """Control steps that the thumb waits."""
    phi: float = 0.7
    """Share of the crush limit that is aimed at."""
    thumb: float = 0.8
    """Share of the aim that the thumb presses with."""
    over: float = 1.3
    """Share of the aim beyond which all digits give way."""
    index: float = 0.7
    ring: float = 0.7
    pinky: float = 0.5
    """Weights of the fingers' shares; the middle's is 1."""
    slip: float = 50.0
    """Growth of the aim for each metre that the object slips beyond 2 mm [1/m]."""

    def increments(
        self, synergy: Array, step: Array, force: Array, limit: Array, far: Array, slip: Array
    ) -> Array:
        """Increments of n hands, shape (n, 6) [rad].

        Args:
            synergy: shape (n, 6) [rad].
            step: control steps since the episode began, shape (n,).
            force: of the palm, if it is known, and of every digit, shape (n, 6) [N].
            limit: crush limit, shape (n,) [N].
            far: distance from the palm to the object's far side, shape (n,) [m].
            slip: of the object in the hand, shape (n,) [m].
        """
        grown = np.minimum(self.phi * (1 + self.slip * np.maximum(slip - 2e-3, 0.0)), 0.95)
        aim = (grown * limit)[:, None]
        weights = np.array([self.index, 1.0, self.ring, self.pinky])
        shares = np.append(self.thumb, weights / weights.sum())
        squeeze = force.sum(axis=1, keepdims=True) / 2
        move = np.clip(self.gain * (shares * aim - force[:, 1:]), -self.back, self.step)
        move[(squeeze > aim)[:, 0]] = np.minimum(move, 0.0)[(squeeze > aim)[:, 0]]
        move = np.where(squeeze > self.over * aim, -self.back, move)
        fast = np.clip(self.fast - self.fastx * (far - 0.05), 0.1, 1.2)[:, None]
        move[:, 1:] = np.where(synergy[:, 1:5] < fast, self.fstep, move[:, 1:])
        move[:, 0] = np.where(synergy[:, 0] < self.tpre, self.tstep, move[:, 0])
        move[step < self.delay, 0] = 0.0
        return np.column_stack([move, np.clip(self.cmc - synergy[:, 5], -0.1, 0.1)])


class Increments(VecEnvWrapper):
    """n hands that are moved by increments of their synergy, and see their last observations.

    Attributes:
        synergy: of every hand, shape (n, 6) [rad].
        age: control steps since its episode began, shape (n,).
    """

    def __init__(self, num_envs: int, obs: str, seed: int, **options: Any) -> None:
        env = HandVecEnv(ID, num_envs, engine="mujoco", body="light", obs=obs, **options)
        size = env.observation_space.shape[0]
        super().__init__(
            env,
            Box(-10.0, 10.0, (STACK * size,), np.float32),
            Box(-1.0, 1.0, (6,), np.float32),
        )
        env.seed(seed)
        self.episodes = env.envs.episodes
        self.task = self.episodes.task
        self.synergy = np.tile(OPEN, (num_envs, 1))
        self.age = np.zeros(num_envs, int)
        self._past = np.zeros((num_envs, STACK, size), np.float32)

    def reset(self) -> Array:
        self._begin(np.ones(self.num_envs, bool), self.venv.reset())
        return self._past.reshape(self.num_envs, -1).copy()

    def _begin(self, worlds: Array, seen: Array) -> None:
        self.synergy[worlds] = OPEN
        self.age[worlds] = 0
        self._past[worlds] = seen[worlds, None]

    def step_async(self, actions: Array) -> None:
        moved = np.sign(actions) * np.square(actions) * LARGEST
        self.synergy = np.clip(self.synergy + moved, HPAC.synergy_min, HPAC.synergy_max)
        self.venv.step_async(action_from_synergy(self.synergy).astype(np.float32))

    def step_wait(self) -> Any:
        seen, reward, done, infos = self.venv.step_wait()
        self.age += 1
        self._past = np.roll(self._past, -1, axis=1)
        self._past[:, -1] = seen
        for world in np.flatnonzero(done):
            last = self._past[world].copy()
            last[-1] = infos[world]["terminal_observation"]
            infos[world]["terminal_observation"] = last.reshape(-1)
        self._begin(done, seen)
        return self._past.reshape(self.num_envs, -1).copy(), reward, done, infos

    def taught(self, rule: Rule) -> Array:
        """Actions of a rule that knows everything, shape (n, 6)."""
        state = self.episodes.now.state
        setups = self.episodes.setups
        far = np.array([one.position[0] + one.object.half_extents[0] for one in setups])
        slip = self.task.grip.slip * (self.age > STEPS // 2)
        move = rule.increments(
            self.synergy, self.age, state.contact_force, self.task.crush_limit, far, slip
        )
        return action_of(move)


def action_of(move: Array) -> Array:
    """Actions of increments, shape (n, 6)."""
    share = np.clip(move / LARGEST, -1.0, 1.0)
    return np.sign(share) * np.sqrt(np.abs(share))


def episodes_of(env: Increments, act: Callable[[Array], Array], seed: int) -> dict[str, Array]:
    """Outcome of one episode of each world, from consecutive seeds."""
    env.seed(seed)
    seen = env.reset()
    limit = env.task.crush_limit.copy()
    success = np.zeros(env.num_envs, bool)
    crushed = success.copy()
    ended = np.full(env.num_envs, STEPS)
    over = success.copy()
    for step in range(STEPS):
        seen, _, done, infos = env.step(act(seen))
        for world in np.flatnonzero(done & ~over):
            success[world] = infos[world]["is_success"]
            crushed[world] = infos[world]["is_crushed"]
            ended[world] = step
        over |= done
        if over.all():
            break
    return {"limit": limit, "success": success, "crushed": crushed, "ended": ended}


def learner(env: Increments, seed: int, **settings: Any) -> Any:
    """A PPO of Stable-Baselines3 that has learned nothing yet."""
    from stable_baselines3 import PPO

    chosen = {
        "n_steps": STEPS,
        "batch_size": 1024,
        "n_epochs": 5,
        "learning_rate": 2e-4,
        "gamma": 0.99,
        "gae_lambda": 0.95,
        "target_kl": 0.02,
        "policy_kwargs": {"net_arch": [128, 128], "log_std_init": -2.0},
    } | settings
    return PPO("MlpPolicy", env, seed=seed, device="cpu", **chosen)


def mean_action(model: Any, seen: Array) -> Array:
    """Actions of a learned policy, shape (n, 6)."""
    return model.predict(seen, deterministic=True)[0]


def imitate(
    model: Any, env: Increments, rule: Rule, rounds: int, rng: np.random.Generator, epochs: int = 3
) -> list[float]:
    """DAgger: the policy learns what the rule would have done where the policy has been.

    Returns:
        Share of the episodes of each round that succeeded.
    """
    optimizer = torch.optim.Adam(model.policy.parameters(), lr=1e-3)
    inputs: list[torch.Tensor] = []
    targets: list[torch.Tensor] = []
    shares = []
    seen = env.reset()
    for number in range(rounds):
        ended = succeeded = 0
        for _ in range(STEPS):
            taught = env.taught(rule)
            inputs.append(torch.as_tensor(seen))
            targets.append(torch.as_tensor(taught, dtype=torch.float32))
            actions = taught if number == 0 else mean_action(model, seen)
            seen, _, done, infos = env.step(actions)
            ended += int(done.sum())
            succeeded += sum(bool(infos[world]["is_success"]) for world in np.flatnonzero(done))
        shares.append(succeeded / max(ended, 1))
        data = torch.cat(inputs)
        told = torch.cat(targets)
        for part in (
            rng.permutation(np.arange(epochs * len(data)) % len(data))
            .reshape(-1)[: min(epochs * len(data), 300 * 1024)]
            .reshape(-1, 1024 if len(data) % 1024 == 0 else len(data) // 10)
        ):
            loss = (
                (model.policy.get_distribution(data[part]).distribution.mean - told[part])
                .square()
                .mean()
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
        print(
            f"round {number}: {shares[-1]:.3f} of {ended} held, loss {loss.item():.4f}", flush=True
        )
    return shares
