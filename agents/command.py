"""What every command of this package shares."""

import argparse

from hpac import Parser


def command_parser(module: str, description: str) -> Parser:
    """The parser of ``python -m module``; its help tells the first line of a description and every default."""
    formatter = argparse.ArgumentDefaultsHelpFormatter
    return Parser(prog=f"python -m {module}", description=description.splitlines()[0], formatter_class=formatter)


def minutes(text: str) -> float:
    """A type of argument: a positive number of minutes."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"'{text}' is not a positive number of minutes")
    return value
