"""A conformance suite of docs/wire.md for any device. It moves a hand by at most 0.3 rad per servo.

It uses a codec of its own and observes only the device's answers, so that it runs against any
device that claims to implement the protocol: a board, the host board, a virtual hand, a user's own
firmware."""

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from hpac_gym.bridge.evidence.device import BrokenRule, Device
from hpac_gym.bridge.evidence.frame_rules import FRAME_RULES
from hpac_gym.bridge.evidence.motion_rules import MOTION_RULES
from hpac_gym.bridge.evidence.stop_rules import STOP_RULES
from hpac_gym.bridge.interrupts import interrupts
from hpac_gym.bridge.transport import Transport
from hpac_gym.model import HPAC, Hand

RULES = FRAME_RULES | MOTION_RULES | STOP_RULES
"""In the order of the document."""
_BOOT_TIME = 3.0
"""Time in which a device must answer its first HELLO [s]: a board may restart when its port opens."""


@dataclass(frozen=True, slots=True)
class Row:
    """Result of the device for one rule of the document."""

    rule: str
    tried: int
    """Number of checks of the rule, up to the first failure."""
    failure: str
    """Description of the failure; empty if the rule holds."""

    @property
    def holds(self) -> bool:
        """Whether the rule was checked and held."""
        return self.tried > 0 and not self.failure

    def __str__(self) -> str:
        return "\n        ".join(filter(None, [f"{self.tried:5} tries  {self.rule}", self.failure]))


def conform(transport: Transport, hand: Hand = HPAC, patience: float = 0.3) -> Iterator[Row]:
    """Check every rule on the device behind a transport, one after the other. The transport is
    closed at the end.

    Args:
        hand: the hand whose limits the device should have.
        patience: time-out of one answer [s].
    """
    device = Device(transport, hand, patience)
    interrupts.link_opened(device)
    try:
        for _ in range(math.ceil(_BOOT_TIME / patience)):
            with suppress(BrokenRule):
                device.hash = device.hello(0).limits_hash
                break
        for rule, check in RULES.items():
            device.tried = 0
            failure = ""
            try:
                check(device)
            except BrokenRule as broken:
                failure = str(broken)
            yield Row(rule, device.tried, failure)
    finally:
        device.end()
        interrupts.link_closed(device)
