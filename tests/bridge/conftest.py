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
def link(virtual_hand):
    """A connected link to `virtual_hand`, not armed."""
    with HandLink(virtual_hand.connect) as connected:
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


@pytest.fixture
def overheard(virtual_hand):
    """A transport to `virtual_hand` that can lose its frames."""
    return Overheard(virtual_hand)
