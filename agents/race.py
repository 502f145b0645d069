"""Train an algorithm of Stable-Baselines3, sb3-contrib or SBX for comparison: ``python -m
agents.race ppo --out runs/NAME``.

Every contender runs on a batch and gets the same processor time; without options on MuJoCo, with
the dense reward and *deploy*. The worlds of PyBullet are processes of their own, whose time is not
counted. The folder gets ``policy.hpac`` and ``progress.csv``, updated every minute. A run cannot be
resumed. ``--set`` also takes the algorithm's arguments, such as ``gamma=0.9`` or
``policy_kwargs.net_arch=64,64``, ``num_envs`` and ``action_repeat``."""

import sys
import time
from collections.abc import Callable, Mapping
from inspect import signature
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize
from torch import nn

from agents import POLICY, RecipeError, RunError, target_of
from agents.contenders import BOUND, BOUNDS, CONTENDERS, algorithm_of, trained_actor
from agents.progress import CURVE, Progress
from agents.runs import alone_in
from hpac_gym.command import command_parser, minutes, run
from hpac_gym.envs.sb3 import HandVecEnv
from hpac_gym.evaluation.environment import versions, with_object
from hpac_gym.evaluation.options import add_env_options, env_options, with_set
from hpac_gym.evaluation.seeds import training_seed
from hpac_gym.output import writable_folder
from hpac_gym.policies import PolicyFile, write_policy
from hpac_gym.registration import GRASP, full_id, row_of

SAVE_EVERY_S = 60.0


class Decisions(VecEnvWrapper):
    """Wrapper that holds each action for several control steps and sums the rewards.

    If an episode ends within the `repeat` steps, the next one waits with an open hand for the rest
    of them. With a `bound` of the actions the worlds get their tanh; None passes actions in −1…1
    unchanged."""

    def __init__(self, worlds: VecEnv, repeat: int, bound: float | None) -> None:
        space = worlds.action_space
        super().__init__(
            worlds, action_space=space if bound is None else type(space)(-bound, bound, space.shape)
        )
        self._repeat = repeat
        self._bound = bound

    def reset(self) -> np.ndarray:
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Set the actions of the next decision, shape (n, 6)."""
        self._actions = actions if self._bound is None else np.tanh(actions)

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Hold the actions; returns observations, summed rewards, dones and infos."""
        seen, rewards, over, infos = self.venv.step(self._actions)
        for _ in range(self._repeat - 1):
            seen, gained, done, told = self.venv.step(np.where(over[:, None], -1.0, self._actions))
            rewards = rewards + gained * ~over
            infos = [a if o else b for a, b, o in zip(infos, told, over, strict=True)]
            over = over | done
        return seen, rewards, over, infos


def learner_of(
    name: str,
    settings: Mapping[str, Any],
    share: Callable[[], float],
    env_id: str = GRASP,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> BaseAlgorithm:
    """Create the algorithm with its worlds; `share` returns the elapsed share of its time, 0…1.

    Raises:
        RecipeError: The environment does not observe a vector, the algorithm refuses a setting, or
            its library is not installed.
    """
    algorithm = algorithm_of(name)
    squashed = name != "ppo"
    own = dict(settings)
    for key, (kind, least, most) in BOUNDS.items():
        if not (isinstance(own[key], kind) and least <= own[key] <= most):
            whole = "whole " * (kind is int)
            raise RecipeError(
                f"{name}: {key} is {own[key]!r}, must be a {whole}number from {least} to {most}"
            )
    if not isinstance(own["policy_kwargs"], Mapping):
        raise RecipeError(f"{name}: policy_kwargs is {own['policy_kwargs']!r}, must have names")
    num_envs, repeat, rate = map(own.pop, ("num_envs", "action_repeat", "learning_rate"))
    worlds = HandVecEnv(full_id(env_id), num_envs, **with_object(options))
    if not isinstance(worlds.observation_space, Box) or worlds.observation_space.shape[1:]:
        worlds.close()
        raise RecipeError(f"env is '{env_id}': its observation is not a vector")
    decisions = Decisions(worlds, repeat, None if squashed else BOUND)
    own["seed"] = training_seed(own["seed"], 0, num_envs)
    # A new dictionary, since some algorithms add to it.
    own["policy_kwargs"] = own["policy_kwargs"] | ({} if squashed else {"activation_fn": nn.ReLU})
    try:
        return algorithm(
            "MlpPolicy",
            VecNormalize(decisions, norm_reward=not squashed, gamma=own["gamma"], epsilon=1e-4),
            learning_rate=lambda _: rate * max(0.05, 1.0 - share()),
            device="cpu",
            **own,
        )
    except (AssertionError, TypeError, ValueError) as error:
        worlds.close()
        raise RecipeError(f"{name} refuses its settings: {str(error).splitlines()[0]}") from error


def race(
    name: str,
    settings: Mapping[str, Any],
    out: Path,
    time_limit: float,
    env_id: str = GRASP,
    options: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Train a contender in the folder `out` for `time_limit` seconds of processor time.

    Raises:
        EnvError: The environment is none of `hpac_gym.register`.
        RecipeError: The library of its algorithm is not installed, or it refuses a setting.
        RunError: The folder already holds a run, another training writes to it, or this one diverged.
    """
    algorithm_of(name)
    if any((out / file).exists() for file in (POLICY, CURVE)):
        raise RunError(f"folder '{out}' already holds a run: name another one")
    row_of(env_id)
    target = target_of(env_id, **options)
    writable_folder(out)
    with alone_in(out):
        _train(name, settings, out, time_limit, env_id, options, target)


def _train(
    name: str,
    settings: Mapping[str, Any],
    out: Path,
    time_limit: float,
    env_id: str,
    options: Mapping[str, Any],
    target: Mapping[str, Any],
) -> None:
    torch.set_num_threads(1)
    progress = Progress(
        out, sys.maxsize, sys.maxsize, time_limit=time_limit, clock=time.process_time
    )
    model = learner_of(name, settings, lambda: progress.share, env_id, options)

    def save() -> None:
        actor = trained_actor(model)
        if not all(np.isfinite(array).all() for layer in actor.layers for array in layer):
            raise ValueError("its weights are not finite")
        about = {
            **target,
            "algorithm": name,
            "action_repeat": settings["action_repeat"],
            "settings": {**settings, "options": dict(options)},
            "episodes": progress.done,
            "decisions": model.num_timesteps,
            "env_steps": model.num_timesteps * settings["action_repeat"],
            "processor_seconds": round(progress.seconds, 1),
            "versions": versions("stable-baselines3", "sb3-contrib", "sbx-rl", "jax"),
        }
        write_policy(out / POLICY, PolicyFile(actor, about))
        progress.write_row(metrics())

    saved_at = 0.0

    def step(now: dict[str, Any], _: Any) -> bool:
        """Count the trials of a step, and save every minute; returns whether the training
        continues.
        """
        nonlocal saved_at
        if progress.seconds > saved_at + SAVE_EVERY_S:
            saved_at += SAVE_EVERY_S
            save()
        held = [
            told["is_success"]
            for told, done in zip(now["infos"], now["dones"], strict=True)
            if done
        ]
        progress.add(held, 0, metrics)  # no budget of control steps
        return progress.going

    def metrics() -> dict[str, float]:
        """What the algorithm has logged lately."""
        told = model.logger.name_to_value.items()
        return {key.removeprefix("train/"): value for key, value in told if np.isscalar(value)}

    try:
        model.learn(sys.maxsize, callback=step)
        save()
    except ValueError as error:  # raised by PyTorch's distributions for values that are not finite
        raise RunError(
            f"the training diverged: {str(error).splitlines()[0]}; '{out}' keeps its last policy"
        ) from error
    progress.close()
    model.env.close()
    print(f"done after {progress.done:,} trials: {out / POLICY}", file=sys.stderr)


def main(argv: list[str] | None = None) -> None:
    parser = command_parser("agents.race", __doc__)
    parser.add_argument("contender", choices=tuple(CONTENDERS), help="which algorithm")
    parser.add_argument("--out", type=Path, required=True, help="folder of the run")
    parser.add_argument(
        "--minutes", type=minutes, default=15.0, help="processor time of the training"
    )
    add_env_options(parser, f"id, also module:My-v0 (default: {GRASP})")
    args = parser.parse_args(argv)
    env_id = args.env or GRASP
    settings = CONTENDERS[args.contender]
    known = {*settings, *signature(algorithm_of(args.contender)).parameters}
    own = [text for text in args.set if text.partition("=")[0].partition(".")[0] in known]
    args.set = [text for text in args.set if text not in own]
    settings = with_set(settings, own)
    race(args.contender, settings, args.out, 60 * args.minutes, env_id, env_options(args, env_id))


if __name__ == "__main__":
    sys.exit(run(main))
