"""Commands called by tests as the command line calls them, but with their exceptions."""

import argparse
from collections.abc import Callable
from contextlib import redirect_stdout
from io import StringIO

import pytest

from hpac import main
from hpac_gym.command import USAGE_ERROR


def help_of(*name: str) -> str:
    """What `hpac`, or one of its commands, tells with ``--help``."""
    with redirect_stdout(StringIO()) as told, pytest.raises(SystemExit):
        main([*name, "--help"])
    return told.getvalue()


def parsed(command, *words: object) -> argparse.Namespace:
    """The namespace that a command gets from its words."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def called(command, *words: object) -> int:
    """The exit status of a command."""
    arguments = parsed(command, *words)
    return arguments.run(arguments)


def refused(capsys, command: Callable[[], int]) -> str:
    """The one line that a command prints when it refuses its words."""
    try:
        status = command()
    except SystemExit as left:
        status = left.code
    said = capsys.readouterr()
    (line,) = said.err.splitlines()
    assert (status, said.out, said.err) == (USAGE_ERROR, "", f"{line}\n")
    assert line.startswith("error: ")
    return line
