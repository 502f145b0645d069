"""The `hpac` command: a table of subcommands, each imported when it is used.

It is on top of everything: nobody imports it. The list of commands loads neither Gymnasium nor
NumPy."""

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from pkgutil import resolve_name
from typing import NoReturn

sys.modules.setdefault("hpac", sys.modules[__name__])  # read by hpac_gym, also for python -m hpac

from hpac_gym import __version__  # noqa: E402
from hpac_gym.command import USAGE_ERROR, Formatter, Parser, run  # noqa: E402


@dataclass(frozen=True, slots=True)
class Command:
    """One row of the table of commands."""

    group: str
    """One of `GROUPS`."""
    name: str
    help: str
    """Help text of one line."""
    target: str
    """`module:function`; the function adds the command's arguments to a parser and sets its default
    `run`, which takes the parsed arguments and returns the exit status."""


GROUPS = {
    "look": "watch and understand",
    "hand": "a real hand, or the firmware on this computer",
    "train": "policies and data (training itself: python -m agents.train in a checkout)",
    "measure": "judge policies and physics",
}
COMMANDS = (
    Command(
        "look",
        "play",
        "move a simulated hand by six sliders, in the browser",
        "hpac_gym.virtual.commands:add_play",
    ),
    Command(
        "look",
        "posture",
        "show, draw or send a gesture or grasp shape of the paper",
        "hpac_gym.posture:add_arguments",
    ),
    Command(
        "look",
        "replay",
        "the log of a deployment beside a simulation of the same actions",
        "hpac_gym.deploy.replay:add_arguments",
    ),
    Command(
        "look",
        "show",
        "watch a trained policy grasp, in the browser",
        "hpac_gym.show:add_arguments",
    ),
    Command(
        "hand",
        "calibrate",
        "fit the hand parameters to a record of a real hand",
        "hpac_gym.calibration.calibrate:add_arguments",
    ),
    Command(
        "hand",
        "clear",
        "leave a fault, or disarm: no motion, no pulses",
        "hpac_gym.bridge.commands:add_clear",
    ),
    Command(
        "hand",
        "conform",
        "test a device against every rule of docs/wire.md",
        "hpac_gym.bridge.commands:add_conform",
    ),
    Command(
        "hand",
        "deploy",
        "run a trained policy on a hand; --dry-run tells what it would do",
        "hpac_gym.deploy.commands:add_arguments",
    ),
    Command(
        "hand",
        "doctor",
        "find hands, report faults and the first remedy; moves nothing",
        "hpac_gym.bridge.commands:add_doctor",
    ),
    Command(
        "hand",
        "estop",
        "stop all pulses now and latch a fault",
        "hpac_gym.bridge.stop:add_arguments",
    ),
    Command(
        "hand",
        "sweep",
        "sweep a hand before a camera (--port), or take a record, and draw the paper's figures",
        "hpac_gym.calibration.sweep:add_arguments",
    ),
    Command(
        "hand",
        "tags",
        "write the sheet of tags to print, or calibrate a camera with it",
        "hpac_gym.camera.commands:add_arguments",
    ),
    Command(
        "hand",
        "virtual",
        "a hand for those who have none: the real firmware and a simulated body",
        "hpac_gym.virtual.commands:add_arguments",
    ),
    Command(
        "hand",
        "wiggle",
        "move one servo at a time next to its name",
        "hpac_gym.bridge.commands:add_wiggle",
    ),
    Command(
        "train",
        "evaluate",
        "evaluate policies on held-out episodes",
        "hpac_gym.evaluation.evaluate:add_arguments",
    ),
    Command(
        "train",
        "export",
        "write a policy file as ONNX with a card",
        "hpac_gym.policies.export:add_arguments",
    ),
    Command(
        "train",
        "record",
        "record episodes of a policy for Minari or LeRobot",
        "hpac_gym.evaluation.dataset:add_arguments",
    ),
    Command(
        "measure",
        "benchmark",
        "judge a policy by the benchmark's protocol, or check results files",
        "hpac_gym.evaluation.benchmark:add_arguments",
    ),
    Command(
        "measure",
        "forecast",
        "how often a policy will succeed on one's own calibrated hand",
        "hpac_gym.evaluation.forecast:add_arguments",
    ),
    Command(
        "measure",
        "grasps",
        "evaluate a policy on the sixteen named grasps",
        "hpac_gym.evaluation.grasps:add_arguments",
    ),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status."""
    # Modules of the current folder, such as the one that registers `--env mymodule:My-v0`. Last, so
    # that a file there hides no library.
    with suppress(OSError):  # a folder that was deleted
        sys.path.append(os.getcwd())
    words = sys.argv[1:] if argv is None else argv

    def command() -> int:
        arguments = parser_of(words).parse_args(words)
        return arguments.run(arguments)

    return run(command, unheard="estop" in words[:1])


def parser_of(argv: Sequence[str]) -> Parser:
    """The parser of `hpac`, with the arguments of the one command that `argv` names."""
    width = max(len(row.name) for row in COMMANDS)
    lines = []
    for group, about in GROUPS.items():
        rows = [row for row in COMMANDS if row.group == group]
        lines += ["", f"{group}: {about}", *(f"  {row.name:<{width}}  {row.help}" for row in rows)]
    parser = Parser(
        prog="hpac",
        usage="hpac [-h] [--version] [--completion] COMMAND ...",
        description="The H-PAC tendon hand, from simulation to the servo.",
        epilog="\n".join(lines)[1:] + "\n\n'hpac COMMAND --help' tells more.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version",
        action="version",
        version=f"hpac_gym {__version__}",
        help="show the version and exit",
    )
    parser.add_argument(
        "--completion",
        action=_Completion,
        nargs=0,
        help='print completion for bash and zsh: eval "$(hpac --completion)"',
    )
    subparsers = parser.add_subparsers(
        prog="hpac",
        metavar="COMMAND",
        required=True,
        help=argparse.SUPPRESS,
    )
    parsers = {
        row.name: subparsers.add_parser(row.name, description=row.help, formatter_class=Formatter)
        for row in COMMANDS
    }
    name = next((word for word in argv if not word.startswith("-")), None)
    row = next((row for row in COMMANDS if row.name == name), None)
    if not argv:
        parser.print_help(sys.stderr)
        parser.exit(USAGE_ERROR)
    if row is not None:
        resolve_name(row.target)(parsers[row.name])
    elif name is not None:
        near = get_close_matches(name, parsers, 1)
        parser.error(f"no command '{name}'" + "".join(f", did you mean '{one}'?" for one in near))
    return parser


def completion() -> str:
    """A script that completes commands, options and files in bash and zsh."""
    cases = []
    for row in COMMANDS:
        parser = argparse.ArgumentParser()
        resolve_name(row.target)(parser)
        options = [name for action in parser._actions for name in action.option_strings]
        cases.append(f"    {row.name}) known='{' '.join(options)}' ;;")
    names = " ".join(row.name for row in COMMANDS)
    return f"""if [ -n "$ZSH_VERSION" ]; then
  autoload -U +X compinit bashcompinit && compinit -u && bashcompinit
fi
_hpac() {{
  local known='{names} --help --version'
  [ "$COMP_CWORD" -gt 1 ] && case "${{COMP_WORDS[1]}}" in
{chr(10).join(cases)}
    *) known='' ;;
  esac
  COMPREPLY=($(compgen -W "$known" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -F _hpac hpac"""


class _Completion(argparse.Action):
    """Prints the script of `completion`."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        print(completion())
        parser.exit()


if __name__ == "__main__":
    sys.exit(main())
