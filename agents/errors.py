"""What the agents raise on a user's mistake; their commands print it as one line and end with status 2."""

from hpac_gym.errors import HpacError


class RecipeError(HpacError, ValueError):
    """A recipe is unknown, or one of its settings has no meaning."""


class TaskError(HpacError, ValueError):
    """An environment id is unknown, or its spaces are not those that the agents work with."""


class RunError(HpacError, OSError):
    """A folder of results cannot be read, or not be written."""
