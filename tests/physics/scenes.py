"""Setups of every layout of a scene, with hands of several kinds."""

from dataclasses import fields, replace

import numpy as np

from hpac_gym.body.object_models import load_object_models
from hpac_gym.body.objects import ObjectSpec, Support
from hpac_gym.model import HPAC, scaled_hand, servo_from_synergy
from hpac_gym.physics.engine import Engine, SceneSetup, SceneState
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


def varied(engine: str = "mujoco") -> list[SceneSetup]:
    """Worlds of every layout, and hands of every kind that an engine has."""
    soft = scaled_hand(HPAC, {"drive_stiffness": 0.8})
    slack = replace(
        BODIES["twin"], slack=(1e-3, 0.0, 5e-4, 0.0, 0.0), joint_friction=2e-3, contact_friction=0.7
    )
    setups = [
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
    return [item for item in setups if engine == "mujoco" or not item.hand_settings.hub_inertia]


def close(engine: Engine, steps: int = 24, push: np.ndarray | None = None) -> list[SceneState]:
    """States of every hand on its way to a fist, 5 mm further from its start."""
    n = engine.num_worlds
    servo = np.tile(servo_from_synergy(CLOSED), (n, 6, 1))
    states = []
    for _ in range(steps):
        engine.advance(servo, np.zeros((n, 6, 6)), np.full((n, 6, 3), 5e-3), push)
        states.append(engine.state())
    return states


def bits(states: list[SceneState], world: int) -> bytes:
    """All numbers of a world."""
    return b"".join(
        np.ascontiguousarray(getattr(state, f.name)[world]).tobytes()
        for state in states
        for f in fields(SceneState)
    )
