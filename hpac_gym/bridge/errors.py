"""The bridge's exceptions: subclasses of `HpacError`, each also of the built-in type that a caller
would expect.
"""

import sys
import warnings
from contextlib import suppress

from hpac_gym.errors import HpacError


class BridgeError(HpacError):
    """Base class of all errors between host and hand."""


class FrameError(BridgeError, ValueError):
    """A value does not fit its field on the wire, or received bytes are not a valid frame."""


class VersionError(FrameError):
    """An intact frame of another protocol version."""

    def __init__(self, version: int) -> None:
        super().__init__(f"an intact frame of protocol version {version}")
        self.version = version


class PortError(BridgeError, OSError):
    """The port cannot be opened, is used by another program, or has gone away."""


class HandshakeError(BridgeError, ConnectionError):
    """Nothing answered HELLO, or the answer is not from a firmware for this hand."""


class LinkTimeout(BridgeError, TimeoutError):
    """The hand did not answer in time."""


class RejectedError(BridgeError, RuntimeError):
    """The hand refused a frame. Nothing has changed in it.

    Attributes:
        reason: name of the reason, of `protocol.Reason`.
        servo: name of the servo at fault, or None.
        state: the hand's state, of `protocol.State`.
    """

    def __init__(self, message: str, reason: str, servo: str | None, state: str) -> None:
        super().__init__(message)
        self.reason = reason
        self.servo = servo
        self.state = state


class FaultError(RejectedError):
    """The hand refused a frame because a fault has latched. Only `HandLink.clear` leaves it."""


class StoppedError(BridgeError, RuntimeError):
    """The call was interrupted by `HandLink.estop` or `HandLink.close`, from a signal handler or
    another thread.
    """


class UnconfirmedWarning(UserWarning):
    """A link was closed without confirmation that the pulses are off. The text states what was
    tried and what to do.
    """


class LogWarning(UserWarning):
    """A wire log cannot be written. The link continues without it."""


class FirmwareMissing(BridgeError, FileNotFoundError):
    """The firmware for this computer is not built, and cannot be compiled."""


def tell(warning: Warning) -> None:
    """Warn without ever raising, even if warnings are treated as errors."""
    try:
        warnings.warn(warning, stacklevel=3)
    except Exception:  # or standard error is closed
        with suppress(Exception):
            print(f"{type(warning).__name__}: {warning}", file=sys.stderr)


class ClippedWarning(UserWarning):
    """A servo angle leaves the range that the board was flashed with, and is clipped to it."""
