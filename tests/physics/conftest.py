"""Simulations that begin with the setups of their worlds, and end with their test."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from hpac_gym.physics.engine import SceneSetup
from hpac_gym.physics.simulation import Simulation, make_engine


@pytest.fixture
def begun() -> Iterator[Callable[..., Simulation]]:
    """Makes a simulation by the name of its engine, with a world for each setup."""
    with ExitStack() as open_engines:

        def begin(name: str, *setups: SceneSetup, **settings) -> Simulation:
            simulation = Simulation(make_engine(name, len(setups), **settings))
            open_engines.callback(simulation.engine.close)
            simulation.reset(range(len(setups)), setups)
            return simulation

        yield begin
