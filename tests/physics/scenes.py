"""Setups of every layout of a scene, with hands of several kinds."""

from dataclasses import replace

import numpy as np

from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.model import HPAC, scaled_hand
from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.settings import BODIES

OPPOSED = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.2])
CLOSED = np.array([0.8, *HPAC.synergy_max[1:5], 1.2])
PLACE = np.array([0.042, 0.0, 0.105])
TARGET = np.array([0.042, -0.12, 0.105])


def primitive(shape: str = "cylinder", **change) -> SceneSetup:
    half = {
        "cylinder": (0.025, 0.025, 0.06),
        "box": (0.02, 0.025, 0.05),
        "sphere": (0.028, 0.028, 0.028),
    }[shape]
    return replace(SceneSetup(ObjectSpec(shape, half, 0.1, 0.8), PLACE, 0.2, OPPOSED), **change)


def named(name: str, **change) -> SceneSetup:
    model = load_object_models()[name]
    half = tuple(1.1 * side for side in model.half_extents)
    return replace(
        SceneSetup(
            ObjectSpec(model.shape, half, 1.2 * model.mass, 0.7, name, 1.1), PLACE, 0.0, OPPOSED
        ),
        **change,
    )


def varied() -> list[SceneSetup]:
    """Worlds of every layout, and hands of several kinds."""
    soft = scaled_hand(HPAC, {"drive_stiffness": 0.8})
    slack = replace(
        BODIES["twin"], slack=(1e-3, 0.0, 5e-4, 0.0, 0.0), joint_friction=2e-3, contact_friction=0.7
    )
    return [
        primitive("cylinder"),
        primitive("box", hand=soft),
        primitive("sphere", hand_settings=BODIES["light"]),
        primitive("cylinder", hand_settings=slack, target=TARGET),
        named("scissors"),
        named(
            "tennis_ball",
            position=np.array([0.06, 0.0, 0.13]),
            support=Support((0.03, 0.03), gap=(0.04, 0.04)),
        ),
        SceneSetup(None),
        primitive("sphere", fixed=True, target=TARGET),
    ]
