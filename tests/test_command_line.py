"""One line for a mistake, and the exit status that says what happened."""

import argparse
import sys

import pytest

from hpac_gym.command_line import INTERRUPTED, USAGE_ERROR, MissingModule, Parser, needing, run, whole_number
from hpac_gym.errors import WorkspaceError


def raising(error: BaseException):
    def command() -> int:
        raise error

    return command


def test_the_status_is_the_commands_own():
    assert run(lambda: 0) == 0
    assert run(lambda: 7) == 7


def test_an_error_on_purpose_is_one_line_and_any_other_is_not_hidden(capsys):
    assert run(raising(WorkspaceError("2 rad\n  above 1 rad"))) == USAGE_ERROR
    assert capsys.readouterr().err == "error: 2 rad above 1 rad\n"
    with pytest.raises(ValueError, match="a bug"):
        run(raising(ValueError("a bug")))


def test_ctrl_c_has_its_own_status(capsys):
    assert run(raising(KeyboardInterrupt())) == INTERRUPTED
    assert capsys.readouterr().err == "interrupted\n"


def test_the_parser_complains_in_one_line(capsys):
    with pytest.raises(SystemExit) as left:
        Parser(prog="hpac some").parse_args(["--nonsense"])
    assert left.value.code == USAGE_ERROR
    assert capsys.readouterr().err == "error: unrecognized arguments: --nonsense (see hpac some --help)\n"


@pytest.mark.parametrize("text", ["0", "-3", "1.5", "many", ""])
def test_what_is_no_whole_number_of_that_size_is_refused(text):
    assert whole_number(1)("12") == 12
    with pytest.raises(argparse.ArgumentTypeError, match=f"'{text}' is not a whole number of at least 1"):
        whole_number(1)(text)


def test_a_missing_package_is_told_with_the_extra_that_brings_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(MissingModule, match=r"pip install 'hpac_gym\[grasps\]' \(no module PIL\)"), needing("grasps"):
        import PIL  # noqa: F401


def test_a_missing_module_of_this_package_is_a_bug_and_no_missing_extra():
    with pytest.raises(ModuleNotFoundError) as caught, needing("grasps"):
        import hpac_gym.nothing  # noqa: F401
    assert not isinstance(caught.value, MissingModule)
