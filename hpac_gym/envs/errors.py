"""Errors of the environments."""

from hpac_gym.errors import HpacError


class EpisodeError(HpacError, RuntimeError):
    """A call that does not fit the state of the environment: before reset, after the end, or after close."""
