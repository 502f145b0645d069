"""One PyBullet world: its client, its time step and its solver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn, SupportsIndex

import pybullet

from hpac_gym.sim.quiet import quiet_output

GRAVITY = 9.81
"""[m/s²]"""


@dataclass(frozen=True, slots=True)
class WorldSettings:
    """How the world is integrated; `docs/physics.md` has the measurements behind the numbers.

    Raises:
        ValueError: A rate that is not positive, or an error reduction that is no share.
    """

    physics_hz: int = 120
    """Physics steps a second."""
    gravity: float = GRAVITY
    """Downwards, along −z [m/s²]."""
    constraint_softness: float = 1e-6
    """Constraint force mixing of the direct solver: just enough to make redundant contacts solvable."""
    error_reduction: float = 0.4
    """Share of a penetration, or of a joint beyond its stop, that a physics step takes back (Bullet's ERP)."""

    def __post_init__(self) -> None:
        if not self.physics_hz > 0:
            raise ValueError(f"physics_hz = {self.physics_hz} Hz must be greater than 0 Hz")
        if not 0 < self.error_reduction <= 1:
            raise ValueError(f"error_reduction = {self.error_reduction} must be a share in ]0, 1]")

    @property
    def dt(self) -> float:
        """Physics step [s]."""
        return 1.0 / self.physics_hz


def refuse_copying(self: object, protocol: SupportsIndex) -> NoReturn:
    """The `__reduce_ex__` of whatever owns a physics client: a copy would step, and close, the original's.

    Raises:
        TypeError: Always.
    """
    raise TypeError(f"a physics world cannot be copied or pickled: make a new {type(self).__name__}")


class World:
    """A physics client without a window. Close it when done, or use it as a context manager."""

    __reduce_ex__ = refuse_copying

    def __init__(self, settings: WorldSettings = WorldSettings()) -> None:
        self.settings = settings
        self.client = pybullet.connect(pybullet.DIRECT)
        self.clear()

    def clear(self) -> None:
        """Remove every body. What is loaded next behaves, to the bit, as in a new world.

        The simple broadphase keeps no tree whose shape depends on the past, and is the faster one for this few bodies.
        """
        pybullet.resetSimulation(pybullet.RESET_USE_SIMPLE_BROADPHASE, physicsClientId=self.client)
        with quiet_output():
            pybullet.setPhysicsEngineParameter(
                fixedTimeStep=self.settings.dt,
                constraintSolverType=pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG,
                globalCFM=self.settings.constraint_softness,
                erp=self.settings.error_reduction,
                contactERP=self.settings.error_reduction,
                deterministicOverlappingPairs=1,
                physicsClientId=self.client,
            )
        pybullet.setGravity(0, 0, -self.settings.gravity, physicsClientId=self.client)

    def step(self) -> None:
        """Advance by one physics step."""
        pybullet.stepSimulation(self.client)

    def close(self) -> None:
        """Disconnect. Closing twice is no error."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
