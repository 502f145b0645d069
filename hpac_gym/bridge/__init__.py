"""The serial link: from a `ServoCommand` to the pulses of six servos. Needs the model, numpy and
pyserial.

```python
from hpac_gym.bridge import HandLink, HostBoard, VirtualHand, servo_from_pulses

with HostBoard() as hand, HandLink(hand.connect) as link:   # or VirtualHand(): the same firmware, in virtual time
    link.arm()
    for command in commands:
        link.move(command)
        link.wait()
        servo = servo_from_pulses(hand.pulses())            # commanded angles, within 1e-4 rad of command.servo
```
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hpac_gym.bridge.errors import (
        BridgeError,
        ClippedWarning,
        FaultError,
        FirmwareMissing,
        FrameError,
        HandshakeError,
        LinkTimeout,
        PortError,
        RejectedError,
        StoppedError,
        UnconfirmedWarning,
    )
    from hpac_gym.bridge.exchange import LinkStatistics, WireLog
    from hpac_gym.bridge.hands import HostBoard, VirtualHand
    from hpac_gym.bridge.limits import pulses_from_servo, servo_from_pulses
    from hpac_gym.bridge.link import HandLink
    from hpac_gym.bridge.protocol import Action, Fault, Reason, Reset, State
    from hpac_gym.bridge.reports import HandInfo, HandStatus
    from hpac_gym.bridge.stream import Stream, StreamCounts
    from hpac_gym.bridge.transport import (
        SerialTransport,
        Transport,
        open_transport,
    )

__all__ = [
    "Action",
    "BridgeError",
    "ClippedWarning",
    "Fault",
    "FaultError",
    "FirmwareMissing",
    "FrameError",
    "HandInfo",
    "HandLink",
    "HandStatus",
    "HandshakeError",
    "HostBoard",
    "LinkStatistics",
    "LinkTimeout",
    "PortError",
    "Reason",
    "RejectedError",
    "Reset",
    "SerialTransport",
    "State",
    "StoppedError",
    "Stream",
    "StreamCounts",
    "Transport",
    "UnconfirmedWarning",
    "VirtualHand",
    "WireLog",
    "open_transport",
    "pulses_from_servo",
    "servo_from_pulses",
]


_MODULES = (
    "errors",
    "protocol",
    "transport",
    "exchange",
    "limits",
    "reports",
    "stream",
    "link",
    "hands",
)
"""Where those names are, from light to heavy: a stop must not wait for NumPy, so a name is imported
when it is used.
"""


def __getattr__(name: str) -> object:
    if name in __all__:
        for module in _MODULES:
            if hasattr(home := import_module(f"hpac_gym.bridge.{module}"), name):
                globals()[name] = getattr(home, name)
                return globals()[name]
    raise AttributeError(f"module 'hpac_gym.bridge' has no attribute {name!r}")
