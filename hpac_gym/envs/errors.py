"""Errors of the environments."""

from hpac_gym.errors import HpacError


class EpisodeError(HpacError, RuntimeError):
    """A call that does not fit the state of the environment: before reset, after the end, or after close."""


class WorkerError(HpacError, RuntimeError):
    """A vector environment has lost one of its processes, or an interrupted call has left them out of step."""
