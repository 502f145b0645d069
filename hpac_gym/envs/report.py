"""What `info` says of a step."""

from __future__ import annotations

from typing import Any

from hpac_gym.envs.grip import Grip
from hpac_gym.envs.quality import grasp_quality
from hpac_gym.envs.task import Outcome
from hpac_gym.sim import Scene


def report(
    scene: Scene, outcome: Outcome, phase: str, terms: dict[str, float], forces: dict[str, float], grip: Grip
) -> dict[str, Any]:
    """The `info` of one step; `docs/environments/README.md` says what its entries mean."""
    info = {
        "is_success": outcome is Outcome.SUCCESS,
        "outcome": outcome.value,
        "phase": phase,
        "reward_terms": terms,
        "contact_force": float(sum(forces.values())),
        "hold_time": grip.time,
        "slip": grip.slip,
    }
    return info if outcome is Outcome.RUNNING else info | {"epsilon": grasp_quality(scene)}
