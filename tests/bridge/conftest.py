"""Hands to talk to: the firmware core in this process, and as a process behind a
pseudo-terminal.
"""

import pytest

from hpac_gym.bridge import HandLink, HostBoard, VirtualHand
from tests.bridge.devices import Overheard


@pytest.fixture
def virtual_hand():
    return VirtualHand()


@pytest.fixture
def overheard(virtual_hand):
    """A wire to `virtual_hand` that may be spoiled."""
    return Overheard(virtual_hand)


@pytest.fixture
def link(overheard):
    """A connected link to `virtual_hand` over `overheard`, not armed."""
    with HandLink(lambda: overheard) as connected:
        yield connected


@pytest.fixture
def armed(link):
    """A connected link to `virtual_hand`, armed."""
    link.arm()
    return link


@pytest.fixture
def host_board():
    with HostBoard() as board:
        yield board
