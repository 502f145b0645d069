"""Training and replay of policies for the H-PAC hand; run from a checkout, not part of the wheel.

The commands share this module: their errors, which end in one line and exit status 2, and what a
policy file says about its origin."""

from typing import Any

from hpac_gym.command import explain_missing_extras
from hpac_gym.errors import HpacError
from hpac_gym.evaluation.environment import make_env
from hpac_gym.policies.made_for import made_for
from hpac_gym.registration import full_id

explain_missing_extras()

POLICY = "policy.hpac"  # name of the policy file in the folder of a run


class RecipeError(HpacError, ValueError):
    """A recipe is unknown, or one of its settings is invalid."""


class RunError(HpacError, OSError):
    """A results folder cannot be read or written."""


def target_of(env_id: str, /, **options) -> dict[str, Any]:
    """Fields of a policy file that identify its environment, with the module that registers it: `env_id`,
    `made_for`, and of the options those without which the policy does not fit, `obs` and `wrist`.

    Raises:
        EnvError: As in `make_env`.
    """
    with make_env(full_id(env_id), **options) as env:
        needed = {name: options[name] for name in ("obs", "wrist") if name in options}
        return {"env_id": full_id(env_id), "made_for": made_for(env), **needed}
