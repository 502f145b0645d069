"""The learner that a recipe describes: Stable-Baselines3's SAC beside environments in worker processes."""

import multiprocessing
import signal
from collections.abc import Callable
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from typing import Any

import gymnasium
import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import SubprocVecEnv, VecEnv, VecEnvWrapper, VecMonitor, VecNormalize

from agents.exploration import RandomClosures
from agents.recipes import Recipe
from agents.tasks import ActionRepeat, make_task
from hpac_gym.policies import Actor

LIBRARIES = ("hpac_gym", "numpy", "gymnasium", "pybullet", "stable_baselines3", "torch")


class Meanwhile(VecEnvWrapper):
    """Does some work of this process's own while the worker processes step."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self.work: Callable[[], None] = lambda: None
        self.ended = np.ones(venv.num_envs, dtype=bool)

    def reset(self):
        self.ended[:] = True
        return self.venv.reset()

    def step_wait(self):
        self.work()
        *rest, self.ended, infos = self.venv.step_wait()
        return *rest, self.ended, infos


class OverlappedSAC(SAC):
    """SAC that updates while its environments step, instead of after it: one core learns, the other one simulates.

    An update misses the transition that is under way, no more. ``steps_per_update`` decisions go with each.
    """

    def __init__(self, *args, recipe: Recipe, **options) -> None:
        # No updates of the library's own; they happen in Meanwhile.
        super().__init__(*args, gradient_steps=0, **options)
        self._steps_per_update = recipe.steps_per_update
        self._closure_steps = recipe.closure_steps
        self._closures = RandomClosures(
            self.n_envs,
            recipe.action_repeat,
            np.random.default_rng(self.seed),
            recipe.closure_begin,
            recipe.closure_release,
        )
        self._steps_owed = 0

    def _sample_action(self, learning_starts, action_noise=None, n_envs=1):
        if self.num_timesteps >= self._closure_steps:
            return super()._sample_action(0, action_noise, n_envs)
        actions = self._closures.actions(self.env.venv.ended)
        return actions, self.policy.scale_action(actions)

    def update_meanwhile(self) -> None:
        """Make the updates that one step of all environments is worth."""
        if self.num_timesteps <= self.learning_starts:
            return
        self._steps_owed += self.n_envs
        updates, self._steps_owed = divmod(self._steps_owed, self._steps_per_update)
        if updates:
            # An update draws exploration noise of its own; the noise that the environments are driven with has to last.
            noise = self.actor.action_dist
            driving = noise.exploration_mat, noise.exploration_matrices
            self.train(updates, self.batch_size)
            noise.exploration_mat, noise.exploration_matrices = driving


def training_env(recipe: Recipe) -> VecNormalize:
    """The recipe's environments, each in a worker process, observations scaled by their running mean and deviation."""
    multiprocessing.set_forkserver_preload(["hpac_gym", "stable_baselines3.common.vec_env.subproc_vec_env"])
    task = partial(_worker_task, recipe.env_id, recipe.action_repeat)
    workers = SubprocVecEnv([task] * recipe.n_envs, start_method="forkserver")
    return VecNormalize(Meanwhile(VecMonitor(workers)), norm_reward=False)


def make_learner(recipe: Recipe, env: VecNormalize) -> OverlappedSAC:
    """A learner with random weights, drawn from the recipe's seed."""
    torch.set_num_threads(recipe.threads)
    model = OverlappedSAC(
        "MlpPolicy",
        env,
        recipe=recipe,
        gamma=recipe.gamma,
        learning_rate=recipe.learning_rate,
        tau=recipe.tau,
        batch_size=recipe.batch_size,
        learning_starts=recipe.learning_starts,
        n_steps=recipe.n_steps,
        train_freq=recipe.sde_sample_freq,
        use_sde=True,
        sde_sample_freq=recipe.sde_sample_freq,
        buffer_size=recipe.buffer_size,
        policy_kwargs={"net_arch": list(recipe.hidden), "optimizer_kwargs": {"fused": True}},
        seed=recipe.seed,
        device="cpu",
    )
    env.venv.work = model.update_meanwhile
    return model


def actor_of(model: SAC) -> Actor:
    """The learner's deterministic actor as plain arrays, with the scaling of its observations."""
    env = model.get_vec_normalize_env()
    layers = [layer for layer in (*model.actor.latent_pi, *model.actor.mu) if isinstance(layer, torch.nn.Linear)]
    return Actor(
        observation_mean=env.obs_rms.mean.copy(),
        observation_scale=np.sqrt(env.obs_rms.var + env.epsilon),
        observation_clip=env.clip_obs,
        layers=tuple((_array(layer.weight), _array(layer.bias)) for layer in layers),
        mean_clip=model.actor.clip_mean,
    )


def versions() -> dict[str, str]:
    """The versions of Python and of the libraries that a result depends on."""
    found = {"python": python_version()}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def _worker_task(env_id: str, action_repeat: int) -> gymnasium.Env:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the learner, which ends its workers itself
    return ActionRepeat(make_task(env_id), action_repeat)


def _array(parameter: Any) -> np.ndarray:
    return parameter.detach().numpy().copy()
