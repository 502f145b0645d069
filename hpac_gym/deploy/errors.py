"""What the parts of a deployment share: its errors, and its sockets for datagrams."""

import socket

from hpac_gym.errors import HpacError

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
        if bind:
            made.bind((host, port))
        else:
            made.connect((host, port))
    except (OSError, OverflowError, TypeError) as error:
        made.close()
        reason = getattr(error, "strerror", error)
        raise DeployError(f"{what}: {reason}") from None
    return made
