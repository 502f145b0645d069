"""What the parts of a deployment share: its errors, and its packets, JSON objects by UDP."""

import json
import socket
from typing import Any

from hpac_gym.errors import HpacError

VERSION = 1
"""Of every packet, in the field that names its kind."""
MALFORMED = (ValueError, KeyError, TypeError, OverflowError, RecursionError)
"""What reading a datagram raises that is none of the expected packets."""


class DeployError(HpacError, RuntimeError):
    """A deployment cannot begin, or was given up; the hand was opened before."""


class PoseError(DeployError):
    """A source of poses has none, an old one, or something that is no pose."""


def udp(what: str, host: str, port: int, bind: bool = False) -> socket.socket:
    """A socket that never waits: connected to a program's port, or bound to one of this computer.

    Raises:
        DeployError: There is no such port, or it is taken; the message calls it `what`.
    """
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    try:
        (made.bind if bind else made.connect)((host, port))
    except (OSError, OverflowError, TypeError) as error:
        made.close()
        reason = getattr(error, "strerror", error)
        raise DeployError(f"{what}: {reason}") from None
    return made


def packet(data: bytes, kind: str) -> dict[str, Any]:
    """The JSON object of a datagram.

    Raises:
        ValueError, KeyError, TypeError, RecursionError: It is none, or of another kind or version.
    """
    found = json.loads(data)
    if found[kind] != VERSION:
        raise ValueError(f"{kind} {found[kind]!r}, this program reads {VERSION}")
    return found
