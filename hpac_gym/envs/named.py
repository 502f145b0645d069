"""The grasp task for one of the sixteen named grasps: its own object, wrist pose and hand shape, the same judgement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpac_gym.envs.grasp import Grasp, GraspConfig
from hpac_gym.envs.grasp_data import NOMINAL, named_grasp
from hpac_gym.model import HPAC, Hand
from hpac_gym.model.checks import Array
from hpac_gym.sim import ObjectSpec, SceneSetup, Support


class GraspByName(Grasp):
    """Draws episodes of one named grasp; judges and rewards them as `Grasp` does.

    Args:
        name: of the grasp.
        variant: of its object; "nominal", or a held-out one.
        config: what counts as dropped, and the timetable; its ranges are not used.

    Raises:
        GraspError: No grasp or variant has that name.
    """

    def __init__(self, name: str, variant: str = NOMINAL, config: GraspConfig = GraspConfig()) -> None:
        super().__init__(config)
        self.grasp = named_grasp(name)
        self.variant = self.grasp.variant(variant)

    def setup(self, rng: np.random.Generator, hand: Hand = HPAC) -> SceneSetup:
        """Draw one episode: where in the hand the object stands, and its turn about the vertical."""
        grasp, variant = self.grasp, self.variant
        model = variant.object or grasp.object
        spec = ObjectSpec(
            model.shape,
            tuple(variant.scale * half for half in model.half_extents),
            variant.mass * model.mass,
            variant.friction * grasp.friction,
            model.name,
            variant.scale,
        )
        noise = rng.uniform(-1.0, 1.0, 4)
        return SceneSetup(
            spec,
            np.array(grasp.position) + noise[:3] * grasp.position_noise,
            float(noise[3] * grasp.yaw_noise),
            grasp.preshape,
            hand,
            hand_quaternion=quaternion_from_rpy(grasp.hand_rpy),
            object_quaternion=quaternion_from_rpy(grasp.object_rpy),
            support=_scaled(grasp.support, variant.scale),
        )


def quaternion_from_rpy(rpy: tuple[float, float, float]) -> tuple[float, float, float, float]:
    """The quaternion xyzw of URDF's fixed-axis roll, pitch, yaw: Rz(yaw) Ry(pitch) Rx(roll)."""
    (sr, sp, sy), (cr, cp, cy) = (tuple(f(np.array(rpy) / 2).tolist()) for f in (np.sin, np.cos))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


def _scaled(support: Support, scale: float) -> Support:
    """Walls as far apart as the object is larger."""
    gap: Array | None = None if support.gap is None else np.array(support.gap) * scale
    return replace(support, gap=None if gap is None else tuple(gap.tolist()))
