"""What `info` says of an episode."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpac_gym.envs.quality import grasp_quality
from hpac_gym.envs.task import Outcome
from hpac_gym.model.checks import Array
from hpac_gym.sim import Scene


class Report:
    """Follows one episode, to tell how far the object has slipped since the hand began to carry it."""

    def __init__(self) -> None:
        self._held_at: Array | None = None

    def info(
        self,
        scene: Scene,
        outcome: Outcome,
        phase: str,
        terms: dict[str, float],
        object_pos: Array,
        forces: dict[str, float],
        hold_time: float,
    ) -> dict[str, Any]:
        """The `info` of one step; `docs/environments/README.md` says what its entries mean."""
        if not hold_time:
            self._held_at = None
        elif self._held_at is None:
            self._held_at = object_pos
        info = {
            "is_success": outcome is Outcome.SUCCESS,
            "outcome": outcome.value,
            "phase": phase,
            "reward_terms": terms,
            "contact_force": float(sum(forces.values())),
            "hold_time": hold_time,
            "slip": 0.0 if self._held_at is None else float(np.linalg.norm(object_pos - self._held_at)),
        }
        return info if outcome is Outcome.RUNNING else info | {"epsilon": grasp_quality(scene)}
