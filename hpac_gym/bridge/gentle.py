"""Slow moves of an armed hand: to where a program begins, and open at its end, whatever happened."""

import math
from contextlib import suppress

import numpy as np

from hpac_gym.bridge.errors import BridgeError, FaultError
from hpac_gym.bridge.link import HandLink
from hpac_gym.bridge.protocol import CONSTANTS
from hpac_gym.model import ServoCommand, move_duration
from hpac_gym.model.checks import Array

GENTLE = 0.25
"""Share of the rate limit at which a hand goes to its start posture and opens."""


def go(link: HandLink, servo: Array) -> None:
    """Move slowly to servo angles, shape (6,) [rad], and wait until they are reached. Errors as of
    `HandLink.move`.
    """
    start = link.status().servo
    duration = move_duration(start, servo, link.board.built_for) / GENTLE + 0.05
    moves = math.ceil(1e3 * duration / CONSTANTS["move_max_ms"])
    for share in np.linspace(0.0, 1.0, moves + 1)[1:]:
        link.move(ServoCommand(start + share * (servo - start), duration / moves))
    link.wait()


def open_hand(link: HandLink) -> None:
    """Open slowly, from wherever the hand is, if it is armed. Errors as of `HandLink.move`."""
    link.exchange.on_ack = None
    link.exchange.refused = None
    state = link.status().state
    link.listen(0.0, "not opened")  # a fault is told, and not cleared by who disarms next
    if state == "armed":
        hand = link.board.built_for
        go(link, np.clip(0.0, hand.servo_min, hand.servo_max))


def release(link: HandLink, error: BaseException) -> None:
    """After an error: open the hand slowly where it still follows, and disarm it; raises nothing of
    the link.
    """
    with suppress(BridgeError):
        if not isinstance(error, FaultError):
            open_hand(link)
    with suppress(BridgeError):
        if link.state == "armed":
            link.clear()
