"""Errors of the policies."""

from hpac_gym.errors import HpacError


class PolicyError(HpacError, ValueError):
    """A policy is unknown, or its file is missing, damaged or made for another environment."""
