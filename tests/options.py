"""Commands called by tests as the command line calls them, but with their exceptions."""

import argparse


def parsed(command, *words: object) -> argparse.Namespace:
    """The namespace that a command gets from its words."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])


def called(command, *words: object) -> int:
    """The exit status of a command."""
    arguments = parsed(command, *words)
    return arguments.run(arguments)
