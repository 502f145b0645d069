"""One PyBullet world: client, time step and solver; and suppression of PyBullet's printed
output.
"""

import ctypes
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from hpac_gym.physics.settings import WorldSettings

_C = ctypes.CDLL(None)
_TURN = threading.Lock()


@contextmanager
def quiet_output() -> Iterator[None]:
    """Discard what C code, such as PyBullet's, writes to file descriptors 1 and 2 while the block
    runs; either may be closed. Blocks in several threads run one after the other: a second one
    would take the first one's sink for what it has to put back.
    """
    for stream in filter(None, (sys.stdout, sys.stderr)):
        stream.flush()
    with _TURN:
        while (sink := os.open(os.devnull, os.O_WRONLY)) <= 2:
            pass  # a closed descriptor stays occupied, so that no other file takes its number
        saved = [(descriptor, os.dup(descriptor)) for descriptor in (1, 2)]
        try:
            for descriptor, _ in saved:
                os.dup2(sink, descriptor)
            yield
        finally:
            _C.fflush(None)  # C buffers its output to a pipe or file
            for descriptor, copy in saved:
                os.dup2(copy, descriptor)
                os.close(copy)
            os.close(sink)


with quiet_output():  # PyBullet prints a greeting on import
    import pybullet

_SOFTNESS = 1e-6
"""Constraint force mixing of the direct solver: just enough to make redundant contacts solvable."""


class World:
    """A physics client without a window, whose bodies have visual shapes if asked for. Close it when
    done.
    """

    def __init__(self, settings: WorldSettings = WorldSettings(), visuals: bool = False) -> None:
        self.settings = settings
        self.visuals = visuals
        self.client = pybullet.connect(pybullet.DIRECT)
        self.clear()

    def clear(self) -> None:
        """Remove every body. Bodies loaded afterwards behave, to the bit, as in a new world.

        The simple broadphase keeps no history-dependent tree, and is the faster one for so few
        bodies."""
        iterations = self.settings.solver_iterations
        solver = (
            pybullet.CONSTRAINT_SOLVER_LCP_SI
            if iterations
            else pybullet.CONSTRAINT_SOLVER_LCP_DANTZIG
        )
        pybullet.resetSimulation(pybullet.RESET_USE_SIMPLE_BROADPHASE, physicsClientId=self.client)
        with quiet_output():
            pybullet.setPhysicsEngineParameter(
                fixedTimeStep=self.settings.dt,
                constraintSolverType=solver,
                **(
                    {"numSolverIterations": iterations, "solverResidualThreshold": 0}
                    if iterations
                    else {}
                ),
                globalCFM=_SOFTNESS,
                erp=self.settings.error_reduction,
                contactERP=self.settings.error_reduction,
                deterministicOverlappingPairs=1,
                physicsClientId=self.client,
            )
        pybullet.setGravity(0, 0, -self.settings.gravity, physicsClientId=self.client)

    def close(self) -> None:
        """Disconnect. Closing twice is allowed."""
        if self.client >= 0:
            pybullet.disconnect(self.client)
            self.client = -1
