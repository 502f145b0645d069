"""What the commands of this package share: argument parsing, and the errors that they print as one line with exit status 2."""

import argparse

from hpac import Parser
from hpac_gym.errors import HpacError


class RecipeError(HpacError, ValueError):
    """A recipe is unknown, or one of its settings is invalid."""


class TaskError(HpacError, ValueError):
    """An environment id is unknown, or its spaces are not supported by the agents."""


class RunError(HpacError, OSError):
    """A results folder cannot be read or written."""


def command_parser(module: str, description: str) -> Parser:
    """Parser of ``python -m module``; its help shows the first line of the description and every default."""
    formatter = argparse.ArgumentDefaultsHelpFormatter
    return Parser(prog=f"python -m {module}", description=description.splitlines()[0], formatter_class=formatter)


def minutes(text: str) -> float:
    """Argument type: a positive number of minutes."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number of minutes")
    return value
