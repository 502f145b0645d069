"""The runner of episodes: every command and measurement that runs a policy in an environment uses
it.

An episode depends only on its seed, not on those that run beside it, nor on whether a world is
single or one of a batch."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import SyncVectorEnv, VectorEnv
from numpy.typing import NDArray

from hpac_gym.envs import HandEnv
from hpac_gym.envs.observations import of_world
from hpac_gym.evaluation.environment import make_env, make_envs
from hpac_gym.policies import Policy
from hpac_gym.policies.policy import ask

BATCH = 50
"""Parallel worlds on MuJoCo."""


@dataclass(frozen=True, slots=True)
class Step:
    """One world after its reset, or after a control step.

    Attributes:
        world: its place among the worlds.
        seed: the seed of its episode.
        number: control steps since the reset; 0 is the reset itself.
        observation: of the world now.
        action: what led here; None after the reset.
        reward: 0 after the reset.
        infos: of all worlds; `info` is that of this one.
    """

    world: int
    seed: int
    number: int
    observation: Any
    action: NDArray[Any] | None
    reward: float
    terminated: bool
    truncated: bool
    infos: Mapping[str, Any]

    @property
    def over(self) -> bool:
        """Whether the episode has ended."""
        return self.terminated or self.truncated

    @property
    def info(self) -> dict[str, Any]:
        """The world's own infos, flat: entries without a value here are left out."""
        return {
            name: values[self.world]
            for name, values in self.infos.items()
            if name[0] != "_"
            and not isinstance(values, Mapping)
            and ((mask := self.infos.get(f"_{name}")) is None or mask[self.world])
        }

    @property
    def success(self) -> bool:
        """Whether the episode has succeeded, or, for a task that has it so, would if it ended now."""
        return bool(self.infos["is_success"][self.world]) if "is_success" in self.infos else False


def run_episodes(
    envs: VectorEnv[Any, Any, Any], policies: Sequence[Policy], seeds: Sequence[int]
) -> Iterator[Step]:
    """Run an episode for each seed; a world whose episode has ended takes the next seed.

    The worlds stand still until the next step is asked for: they can be read, or drawn.

    Args:
        envs: n worlds without autoreset, such as `worlds` gives.
        policies: n policies, which may be the same one if it keeps all of an episode in its state.
        seeds: any number of seeds.

    Yields:
        The reset and every step of every world with a seed, world by world.
    """
    waiting = iter(seeds)
    playing: list[int | None] = [None] * envs.num_envs
    states: list[Any] = [None] * envs.num_envs
    numbers = np.zeros(envs.num_envs, dtype=int)
    over = np.ones(envs.num_envs, dtype=bool)
    actions: list[Any] = [None] * envs.num_envs
    left = len(seeds)
    while left:
        if over.any():
            began = np.flatnonzero(over)
            for world in began:
                playing[world] = seed = next(waiting, None)
                actions[world] = states[world] = None
                numbers[world] = 0
                if seed is not None and (draw := getattr(policies[world], "set_random_seed", None)):
                    draw(seed)
            # At the end, surplus worlds run seed 0; their episodes are discarded.
            seen, infos = envs.reset(
                seed=[seed or 0 for seed in playing], options={"reset_mask": over}
            )
            for world in began:
                if (seed := playing[world]) is not None:
                    yield Step(
                        world, seed, 0, of_world(seen, world), None, 0.0, False, False, infos
                    )
        for world, policy in enumerate(policies):
            if playing[world] is not None:
                begins = np.array([numbers[world] == 0])
                actions[world], states[world] = ask(
                    policy, of_world(seen, world), states[world], begins
                )
        still = np.zeros_like(next(action for action in actions if action is not None))
        seen, rewards, terminated, truncated, infos = envs.step(
            np.stack([still if action is None else action for action in actions])
        )
        over = np.asarray(terminated | truncated)
        numbers += 1
        left -= sum(seed is not None for seed, ended in zip(playing, over, strict=True) if ended)
        for world, seed in enumerate(playing):
            if seed is not None:
                yield Step(
                    world,
                    seed,
                    int(numbers[world]),
                    of_world(seen, world),
                    actions[world],
                    float(rewards[world]),
                    bool(terminated[world]),
                    bool(truncated[world]),
                    infos,
                )


def single(env: gymnasium.Env[Any, Any]) -> VectorEnv[Any, Any, Any]:
    """One environment as worlds for `run_episodes`."""
    return SyncVectorEnv([lambda: env], autoreset_mode="Disabled")


@contextmanager
def worlds(
    env_id: str, options: Mapping[str, Any], episodes: int
) -> Iterator[tuple[gymnasium.Env[Any, Any], VectorEnv[Any, Any, Any]]]:
    """An environment, and worlds of it for some episodes: on MuJoCo a batch, elsewhere that one."""
    with make_env(env_id, **options) as env:
        size = min(BATCH, episodes) if has_batch(env) else 1
        if size == 1:
            yield env, single(env)
        else:
            with closing(make_envs(env_id, size, **options)) as envs:
                yield env, envs


def has_batch(env: gymnasium.Env[Any, Any]) -> bool:
    """Whether an environment can run as a batch: those of this package on MuJoCo."""
    return (
        isinstance(env.unwrapped, HandEnv)
        and env.spec is not None
        and env.spec.vector_entry_point is not None
        and env.unwrapped.episodes.options.engine == "mujoco"
    )
