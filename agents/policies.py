"""Any policy by its name, or from its file: what evaluation, replay and the bridge drive a hand with."""

from pathlib import Path
from typing import Protocol

import gymnasium
import numpy as np

from agents.errors import PolicyError
from agents.policy_file import Actor, PolicyFile, read_policy
from agents.tasks import same_task
from hpac_gym.envs.scripted import scripted_closure

BASELINES = ("random", "scripted")


class Policy(Protocol):
    """What acts. The same seed and the same observations give the same actions."""

    def reset(self, seed: int) -> None:
        """Forget the last episode; ``seed`` is the new one's."""

    def act(self, observation: np.ndarray) -> np.ndarray:
        """The action for an observation, shape (6,), −1…1."""


class RandomPolicy:
    """Uniform actions, anew at every control step."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._shape = env.action_space.shape

    def reset(self, seed: int) -> None:
        # A stream of its own: the environment draws from default_rng(seed) too.
        self._rng = np.random.default_rng([seed, 1])

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._rng.uniform(-1, 1, self._shape).astype(np.float32)


class ScriptedPolicy:
    """The closure by rule that the environment family brings for the task: what learning has to beat."""

    def __init__(self, env: gymnasium.Env) -> None:
        self._closure = scripted_closure(getattr(env.unwrapped, "task", None))

    def reset(self, seed: int) -> None:
        self._closure.reset()

    def act(self, observation: np.ndarray) -> np.ndarray:
        return self._closure.act(observation)


class LearnedPolicy:
    """A trained actor without its exploration, which holds each action for as many control steps as in its training."""

    def __init__(self, actor: Actor, action_repeat: int) -> None:
        self._actor, self._action_repeat = actor, action_repeat

    def reset(self, seed: int) -> None:
        self._step = 0

    def act(self, observation: np.ndarray) -> np.ndarray:
        if self._step % self._action_repeat == 0:
            self._action = self._actor(observation)
        self._step += 1
        return self._action


def load_policy(name: str, env: gymnasium.Env) -> Policy:
    """The policy ``random``, ``scripted``, or of a policy file, for this environment.

    Raises:
        PolicyError: The file is missing, damaged, or made for another environment.
    """
    if name == "random":
        return RandomPolicy(env)
    if name == "scripted":
        return ScriptedPolicy(env)
    policy = policy_file_for(name, env)
    return LearnedPolicy(policy.actor, policy.about.get("action_repeat", 1))


def policy_file_for(name: str, env: gymnasium.Env) -> PolicyFile:
    """The policy file of that path, checked against the environment.

    Raises:
        PolicyError: It is missing, damaged, or made for another environment.
    """
    policy = read_policy(Path(name))
    made_for, env_id = policy.about["env_id"], env.spec.id
    if not same_task(made_for, env_id):
        raise PolicyError(f"policy file '{name}' was trained on {made_for}, not on {env_id}")
    wanted = env.observation_space.shape[0], env.action_space.shape[0]
    if policy.actor.sizes != wanted:
        raise PolicyError(f"policy file '{name}' maps {policy.actor.sizes} values, {env_id} needs {wanted}")
    return policy
