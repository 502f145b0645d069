"""Argument parsing shared by the commands of this package."""

import argparse

from hpac import Parser


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
