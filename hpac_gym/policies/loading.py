"""Any policy by its name, or from its file: what evaluation, replay and the bridge drive a hand with."""

from __future__ import annotations

from pathlib import Path

import gymnasium

from hpac_gym.policies.baselines import BASELINES
from hpac_gym.policies.errors import PolicyError
from hpac_gym.policies.made_for import difference, made_for
from hpac_gym.policies.policy import LearnedPolicy, Policy
from hpac_gym.policies.policy_file import PolicyFile, read_policy


def load_policy(name: str, env: gymnasium.Env) -> Policy:
    """The policy ``random``, ``scripted``, or of a policy file, for this environment.

    Raises:
        PolicyError: No policy has that name; the file is missing, damaged, or made for another environment.
    """
    if name in BASELINES:
        return BASELINES[name](env)
    if not Path(name).exists():
        raise PolicyError(f"no policy file '{name}', and it is none of the baselines {', '.join(BASELINES)}")
    return LearnedPolicy.of(policy_file_for(name, env))


def policy_file_for(name: str, env: gymnasium.Env) -> PolicyFile:
    """The policy file of that path, checked against the environment.

    Raises:
        PolicyError: It is missing, damaged, or made for another environment.
    """
    policy = read_policy(name)
    trained_on, env_id = policy.about["env_id"], env.spec.id
    if not _same_task(trained_on, env_id):
        raise PolicyError(f"policy file '{name}' was trained on {trained_on}, not on {env_id}")
    if (told := difference(policy.about.get("made_for", {}), made_for(env))) is not None:
        raise PolicyError(f"policy file '{name}' does not fit {env_id}: {told}")
    wanted = env.observation_space.shape[0], env.action_space.shape[0]
    if policy.sizes != wanted:
        raise PolicyError(f"policy file '{name}' maps {policy.sizes} values, {env_id} needs {wanted}")
    return policy


def _same_task(first: str, second: str) -> bool:
    """Whether two ids name the same environment and version, wherever it is imported from."""
    return first.rpartition(":")[2] == second.rpartition(":")[2]
