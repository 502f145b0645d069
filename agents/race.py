"""Train an algorithm of Stable-Baselines3 for comparison: ``python -m agents.race ppo --out runs/NAME``.

Every contender runs on a MuJoCo batch, observes *deploy*, gets the dense reward and the same processor time. The folder gets
``policy.zip``, updated every minute, and ``progress.csv``. A run cannot be resumed.
"""

import copy
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import TQC, CrossQ
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
from torch import nn

from agents.command import RunError, command_parser, minutes
from agents.progress import Progress
from agents.tasks import POLICY, target_of, versions
from hpac import run, whole_number
from hpac_gym.envs.options import GRASP
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.evaluation.seeds import training_seed
from hpac_gym.output import writable_folder
from hpac_gym.policies import Actor, PolicyFile, write_policy

ENGINE = "mujoco"
HIDDEN = (128, 128)
SAVE_EVERY_S = 60.0
BOUND = 3.0
"""Bound of PPO's actions, since its normal distribution is unbounded; the environment gets their tanh."""
SATURATED = 20.0
"""Value beyond which tanh is 1 in single precision."""


@dataclass(frozen=True, slots=True)
class Contender:
    """An algorithm and its settings.

    Attributes:
        algorithm: class of Stable-Baselines3.
        settings: its arguments; `learning_rate` is the initial value, which falls linearly to a twentieth.
        num_envs: number of parallel worlds.
        action_repeat: number of control steps for which an action is held.
    """

    algorithm: type[BaseAlgorithm]
    settings: Mapping[str, Any]
    num_envs: int = 32
    action_repeat: int = 4


_REPLAY = {
    "gamma": 0.95, "n_steps": 4, "learning_rate": 5e-4, "batch_size": 256, "learning_starts": 4_000, "gradient_steps": 8,
}  # fmt: skip
CONTENDERS: Mapping[str, Contender] = {
    "ppo": Contender(PPO, {
        "gamma": 0.95, "gae_lambda": 0.9, "learning_rate": 5e-4, "batch_size": 512, "n_steps": 16,
        "policy_kwargs": {"log_std_init": -0.5},
    }, num_envs=128),
    "sac": Contender(SAC, _REPLAY | {"tau": 0.01}),
    "tqc": Contender(TQC, _REPLAY | {"tau": 0.01}),
    "crossq": Contender(CrossQ, _REPLAY | {"learning_rate": 1e-3}),
}  # fmt: skip


class Decisions(VecEnvWrapper):
    """Wrapper that holds each action for several control steps and sums the rewards.

    If an episode ends within these steps, the next one waits with an open hand for the rest of them.

    Args:
        worlds: the wrapped worlds.
        repeat: number of control steps per action.
        bound: bound of the actions, whose tanh the worlds get; None passes actions in −1…1 unchanged.
    """

    def __init__(self, worlds: VecEnv, repeat: int, bound: float | None) -> None:
        space = worlds.action_space
        super().__init__(worlds, action_space=space if bound is None else type(space)(-bound, bound, space.shape))
        self._repeat, self._bound = repeat, bound

    def reset(self) -> np.ndarray:
        """Start an episode in every world."""
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Set the actions of the next decision, shape (n, 6)."""
        self._actions = actions if self._bound is None else np.tanh(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Hold the actions; returns observations, summed rewards, dones and infos."""
        seen, rewards, over, infos = self.venv.step(self._actions)
        for _ in range(self._repeat - 1):
            seen, gained, done, told = self.venv.step(np.where(over[:, None], -1.0, self._actions))
            rewards, infos = rewards + gained * ~over, [a if o else b for a, b, o in zip(infos, told, over, strict=True)]
            over = over | done
        return seen, rewards, over, infos


class _Watch(BaseCallback):
    """Callback that counts trials, saves every minute and ends the training at its time limit."""

    def __init__(self, progress: Progress, save: Callable[[], None]) -> None:
        super().__init__()
        self._progress, self._save, self._next = progress, save, SAVE_EVERY_S

    def _on_step(self) -> bool:
        if self._progress.seconds > self._next:
            self._next += SAVE_EVERY_S
            self._save()
        held = [told["is_success"] for told, done in zip(self.locals["infos"], self.locals["dones"], strict=True) if done]
        return self._progress.add(held, 0, float("nan"))  # no budget of control steps


def learner_of(contender: Contender, seed: int, share: Callable[[], float]) -> BaseAlgorithm:
    """Create the algorithm with its worlds; `share` returns the elapsed share of its time, 0…1."""
    squashed = contender.algorithm is not PPO
    worlds = HandVecEnv(GRASP, contender.num_envs, engine=ENGINE)
    decisions = Decisions(worlds, contender.action_repeat, None if squashed else BOUND)
    settings = dict(contender.settings)
    rate = settings.pop("learning_rate")
    network = {"net_arch": list(HIDDEN), "activation_fn": nn.ReLU, **settings.pop("policy_kwargs", {})}
    return contender.algorithm(
        "MlpPolicy", VecNormalize(decisions, norm_reward=not squashed, gamma=settings["gamma"], epsilon=1e-4), **settings,
        learning_rate=lambda _: rate * max(0.05, 1.0 - share()), seed=training_seed(seed, 0, contender.num_envs), device="cpu",
        policy_kwargs=network,
    )  # fmt: skip


def actor_of(model: BaseAlgorithm) -> Actor:
    """The deterministic actor; the affine parts between two ReLU, such as CrossQ's batch normalisation, become one layer."""
    ppo, scaling = isinstance(model, PPO), model.get_vec_normalize_env()
    policy = model.policy
    parts = [*policy.mlp_extractor.policy_net, policy.action_net] if ppo else [*policy.actor.latent_pi, policy.actor.mu]
    layers, between, width = [], [], model.observation_space.shape[0]
    for part in [*copy.deepcopy(nn.ModuleList(parts)).double().eval(), nn.ReLU()]:
        if not isinstance(part, nn.ReLU):
            between.append(part)
            continue
        with torch.no_grad():
            affine = nn.Sequential(*between)(torch.cat([torch.zeros(1, width), torch.eye(width)]).double()).numpy()
        layers.append(((affine[1:] - affine[0]).T.astype(np.float32), affine[0].astype(np.float32)))
        between, width = [], affine.shape[1]
    mean, scale = scaling.obs_rms.mean.copy(), np.sqrt(scaling.obs_rms.var + scaling.epsilon)
    return Actor(mean, scale, scaling.clip_obs, tuple(layers), BOUND if ppo else SATURATED)


def race(name: str, out: Path, seed: int, time_limit: float) -> None:
    """Train a contender in the folder `out` for `time_limit` seconds of processor time.

    Raises:
        RunError: The folder already holds a run, or the training diverged.
    """
    contender = CONTENDERS[name]
    if (out / POLICY).exists():
        raise RunError(f"folder '{out}' already holds a run: name another one")
    writable_folder(out)
    torch.set_num_threads(1)
    target = target_of(GRASP, engine=ENGINE)
    progress = Progress(out, sys.maxsize, sys.maxsize, time_limit=time_limit, clock=time.process_time)
    model = learner_of(contender, seed, lambda: progress.share)
    settings = {"engine": ENGINE, "hidden": HIDDEN, "seed": seed}
    libraries = {library: version(library) for library in ("stable-baselines3", "sb3-contrib")}

    def save() -> None:
        actor = actor_of(model)
        if not all(np.isfinite(array).all() for layer in actor.layers for array in layer):
            raise ValueError("its weights are not finite")
        about = {
            **target,
            "algorithm": name,
            "action_repeat": contender.action_repeat,
            "settings": asdict(contender) | settings | {"algorithm": contender.algorithm.__name__},
            "episodes": progress.done,
            "decisions": model.num_timesteps,
            "processor_seconds": round(progress.seconds, 1),
            "versions": versions() | libraries,
        }
        write_policy(out / POLICY, PolicyFile(actor, about))

    try:
        model.learn(sys.maxsize, callback=_Watch(progress, save))
        save()
    except ValueError as error:  # raised by PyTorch's distributions for values that are not finite
        raise RunError(f"the training diverged: {str(error).splitlines()[0]}; '{out}' keeps its last policy") from error
    progress.close()
    model.env.close()


def main(argv: list[str] | None = None) -> int:
    parser = command_parser("agents.race", __doc__)
    parser.add_argument("contender", choices=tuple(CONTENDERS), help="which algorithm")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument("--minutes", type=minutes, default=15.0, help="processor time of the training")
    parser.add_argument("--seed", type=whole_number(0), default=0, help="seed of the run")
    args = parser.parse_args(argv)
    race(args.contender, args.out, args.seed, 60 * args.minutes)
    return 0


if __name__ == "__main__":
    sys.exit(run(main))
