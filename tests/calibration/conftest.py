"""A hand in metal and its record, which several tests share."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.bench import JointCamera, Protocol, metal_sweeps
from experiments.hidden import LAWS, hidden_hands
from experiments.populations import Workshop, build
from experiments.quasistatic import Built
from hpac_gym.calibration.record import Sweep
from hpac_gym.model import SERVOS


def without_stops(built: Built) -> Built:
    """The same hand with no stops."""
    return Built(built.hand, tuple(replace(item, stop=()) for item in built.metal))


def of_servos(record: Sweep, *names: str) -> Sweep:
    """The sweeps of some servos."""
    return record[np.isin(record.swept, [SERVOS.index(name) for name in names])]


@pytest.fixture(scope="session")
def hidden() -> Built:
    """A hidden hand without stops, whose physics is that of the fit."""
    return without_stops(hidden_hands(1, 42, LAWS["laws of the fit"])[0])


@pytest.fixture(scope="session")
def record(hidden) -> Sweep:
    """Its record by the usual camera."""
    return metal_sweeps([hidden], 1)[0]


@pytest.fixture(scope="session")
def nominal_record() -> Sweep:
    """The nominal index's record, in metal without any of what the model leaves out, by a good
    camera.
    """
    return metal_sweeps(
        build(Workshop(), 1, 0), 3, JointCamera(noise=np.deg2rad(0.05)), servos=("index_mcp",)
    )[0]


@pytest.fixture(scope="session")
def second(hidden: Built) -> Sweep:
    """Another record of the hidden hand."""
    return metal_sweeps([hidden], 2)[0]


@pytest.fixture(scope="session")
def both_ways(hidden: Built) -> Sweep:
    """Its index with points in both directions."""
    protocol = Protocol(both_directions=True)
    return metal_sweeps([hidden], 1, protocol=protocol, servos=("index_mcp",))[0]
