"""Errors of the agents caused by user input; the commands print them as one line and exit with status 2."""

from hpac_gym.errors import HpacError


class RecipeError(HpacError, ValueError):
    """A recipe is unknown, or one of its settings is invalid."""


class TaskError(HpacError, ValueError):
    """An environment id is unknown, or its spaces are not supported by the agents."""


class RunError(HpacError, OSError):
    """A results folder cannot be read or written."""
