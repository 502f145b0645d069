"""The errors of a deployment."""

from hpac_gym.errors import HpacError

MALFORMED = (ValueError, KeyError, TypeError, OverflowError, RecursionError)
"""What reading a datagram raises that is none of the expected packets."""


class DeployError(HpacError, RuntimeError):
    """A deployment cannot begin, or was given up; the hand was opened before."""


class PoseError(DeployError):
    """A source of poses has none, an old one, or something that is no pose."""
