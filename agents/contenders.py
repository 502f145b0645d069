"""The contenders of `agents.race`: algorithms and their settings."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pkgutil import resolve_name
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm

from agents import RecipeError
from agents.recipes import applies, check, setting
from hpac_gym.errors import install

ALGORITHMS: Mapping[str, str] = {
    "ppo": "stable_baselines3:PPO",
    "sac": "stable_baselines3:SAC",
    "tqc": "sb3_contrib:TQC",
    "crossq": "sb3_contrib:CrossQ",
    "sbx-sac": "sbx:SAC",
    "sbx-tqc": "sbx:TQC",
    "sbx-crossq": "sbx:CrossQ",
}
_REPLAY = tuple(ALGORITHMS)[1:]
_AVERAGED = ("sac", "tqc", "sbx-sac", "sbx-tqc")


@dataclass(frozen=True, slots=True)
class Contender:
    """Settings of one training with an algorithm of `ALGORITHMS`; those with Stable-Baselines3's
    names are its arguments.

    Raises:
        RecipeError: A setting is out of bounds, or its algorithm has no such setting.
    """

    algorithm: str
    seed: int = setting(0, "seed of the run", 0, 2**31 - 1)
    num_envs: int = setting(32, "number of parallel worlds", 1, 65_536)
    action_repeat: int = setting(
        4, "control steps for which an action is held: one decision", 1, 64
    )
    hidden: tuple[int, ...] = setting((128, 128), "widths of the layers", 1, 4_096)
    learning_rate: float = setting(
        5e-4,
        "initial learning rate; it falls linearly to a twentieth, except in sbx-crossq",
        1e-8,
        1,
    )
    gamma: float = setting(0.95, "discount of a decision", 0, 1)
    batch_size: int = setting(256, "batch size of an update, in decisions", 2, 65_536)
    n_steps: int = setting(
        4,
        "ppo: decisions in each world between updates; others: decisions of an n-step return",
        1,
        65_536,
    )
    n_epochs: int = setting(10, "passes over the decisions of an update", 1, 1_000, of=("ppo",))
    gae_lambda: float = setting(
        0.9, "lambda of the generalized advantage estimate", 0, 1, of=("ppo",)
    )
    clip_range: float = setting(
        0.2, "largest change of a probability ratio in an update", 1e-6, 10, of=("ppo",)
    )
    ent_coef: float = setting(0.0, "weight of the entropy in the loss", 0, 10, of=("ppo",))
    vf_coef: float = setting(0.5, "weight of the value function in the loss", 0, 100, of=("ppo",))
    max_grad_norm: float = setting(0.5, "largest norm of a gradient", 1e-6, 1e6, of=("ppo",))
    log_std_init: float = setting(
        -0.5, "initial logarithm of the actor's standard deviation", -10, 2, of=("ppo",)
    )
    buffer_size: int = setting(
        1_000_000, "capacity of the replay buffer, in decisions", 1, 10**9, of=_REPLAY
    )
    learning_starts: int = setting(
        4_000, "random decisions before the first update", 1, 10**9, of=_REPLAY
    )
    train_freq: int = setting(1, "decisions in each world between updates", 1, 65_536, of=_REPLAY)
    gradient_steps: int = setting(8, "gradient steps of an update", 1, 65_536, of=_REPLAY)
    target_entropy: float = setting(
        -6.0, "target entropy of the actor [nats]", -100, 100, of=_REPLAY
    )
    tau: float = setting(
        0.01, "step of the target networks towards the critics", 1e-6, 1, of=_AVERAGED
    )
    target_update_interval: int = setting(
        1, "gradient steps for each step of the target networks", 1, 10**6, of=_AVERAGED[:2]
    )
    top_quantiles_to_drop_per_net: int = setting(
        2, "highest of a critic's 25 quantiles left out", 0, 24, of=("tqc", "sbx-tqc")
    )
    policy_delay: int = setting(
        3,
        "updates of the critics for each update of the actor",
        1,
        1_000,
        of=("crossq", "sbx-crossq"),
    )

    def __post_init__(self) -> None:
        check(self)
        if not self.hidden:
            raise RecipeError("hidden needs at least one width")
        for entry in fields(self):
            if not applies(entry, self.algorithm) and getattr(self, entry.name) != entry.default:
                raise RecipeError(
                    f"{entry.name} is a setting of {', '.join(entry.metadata['of'])}, not of {self.algorithm}"
                )
        if self.algorithm == "ppo" and self.num_envs * self.n_steps < 2:
            raise RecipeError(
                "num_envs and n_steps are 1: an update of ppo needs at least 2 decisions"
            )

    @property
    def settings(self) -> dict[str, Any]:
        """The settings that its algorithm has, by name."""
        return {
            entry.name: getattr(self, entry.name)
            for entry in fields(self)
            if applies(entry, self.algorithm)
        }


CONTENDERS: Mapping[str, Contender] = {
    "ppo": Contender("ppo", num_envs=128, batch_size=512, n_steps=16),
    **{name: Contender(name, learning_rate=1e-3 if "crossq" in name else 5e-4) for name in _REPLAY},
}


def algorithm_of(name: str) -> type[BaseAlgorithm]:
    """Import an algorithm of `ALGORITHMS`.

    Raises:
        RecipeError: Its library is not installed.
    """
    try:
        return resolve_name(ALGORITHMS[name])
    except ModuleNotFoundError as error:
        raise RecipeError(
            f"{name} needs {error.name}, which is not installed: {install('train,sbx')}"
        ) from None
