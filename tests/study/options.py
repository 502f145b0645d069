"""The namespace that a command gets from its words."""

import argparse


def parsed(command, *words: object) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args([str(word) for word in words])
